"""What pages say, read without a browser."""

from __future__ import annotations

import base64
import itertools
import json
import re
import shutil
from html import unescape

import numpy as np
import pytest

from orchestrator.base.errors import ConfigError
from orchestrator.cli.main import main
from orchestrator.config import load_config
from orchestrator.plotting.page import SignalStore
from orchestrator.plotting.page.signals import extremes
from orchestrator.report.graph_layout import Node, Wire, lay_out
from orchestrator.report.graph_svg import draw_graph
from orchestrator.report.make import report
from orchestrator.report.punctuality import punctuality
from orchestrator.report.store_page import SweepTable, page_of_tables
from orchestrator.results.recorders import Results, read_results


def held(text: str) -> dict:
    """The data that a page holds."""
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.S)[1])


def decoded(kept: dict) -> np.ndarray:
    return np.frombuffer(base64.b64decode(kept["data"]), "<" + kept["type"])


def words(text: str) -> str:
    return unescape(re.sub(r"<[^>]+>", " ", text))


def headline(text: str) -> str:
    return unescape(re.search(r"<p class=headline>(.*?)</p>", text, re.S)[1])


def test_extremes_keep_every_peak_and_the_order():
    values = np.array([0.0, 5.0, -1.0, 2.0, 2.0, 2.0, 7.0])
    assert extremes(values, 3).tolist() == [5.0, -1.0, 2.0, 2.0, 7.0, 7.0]
    noise = np.random.default_rng(1).normal(size=10_007)
    thin = extremes(noise, 50)
    assert len(thin) == 402
    assert thin.min() == noise.min() and thin.max() == noise.max()


def test_a_page_within_the_budget_holds_every_instant(line_run):
    results = read_results(line_run)
    arrays = held(report([line_run]))["arrays"]
    assert decoded(arrays["time"]).tolist() == results.time.tolist()
    assert decoded(arrays["contact.force"]) == pytest.approx(results["contact.force"], rel=1e-6)


def test_a_smaller_budget_thins_keeps_peaks_and_says_so(line_run):
    text = report([line_run], budget=40_000)
    results, arrays = read_results(line_run), held(text)["arrays"]
    force = decoded(arrays["contact.force"])
    assert len(force) < len(results) / 3
    assert force.min() == pytest.approx(results["contact.force"].min(), rel=1e-6)
    assert sum(len(one.get("data", "")) for one in arrays.values()) < 44_000
    assert "4001 instants are too many for a page" in words(text)


def test_numbers_that_are_none_or_too_large_are_kept_apart():
    values = np.array([0.0, np.nan, 1e300, np.inf])
    store = SignalStore(10_000)
    store.add(Results(np.arange(4.0), {"a": values, "b": np.full(4, np.nan)}), ["a", "b"])
    arrays = store.data()["arrays"]
    assert arrays["a"]["type"] == "f8" and decoded(arrays["a"])[2] == 1e300
    assert arrays["b"] == {"constant": None}


def test_a_run_without_a_summary_is_reported_as_killed(line_run, tmp_path):
    folder = tmp_path / "killed"
    shutil.copytree(line_run, folder)
    (folder / "summary.json").unlink()
    assert headline(report([folder])).startswith("Killed at 2 s or shortly after, without a summary")


def test_a_failed_run_is_reported_with_its_error(line_run, tmp_path):
    folder = tmp_path / "failed"
    shutil.copytree(line_run, folder)
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    kept = {key: summary[key] for key in ("title", "config", "run", "parameters", "provenance")}
    kept["error"] = {"kind": "StepError", "message": "robot at 2 s: <broken>", "log": ["a & b"]}
    (folder / "summary.json").write_text(json.dumps(kept), encoding="utf-8")
    text = report([folder])
    assert headline(text) == "Failed at 2 s: robot at 2 s: <broken>"
    assert "<broken>" not in text and "<li>a &amp; b</li>" in text


@pytest.mark.parametrize(("kind", "state"), [("Interrupted", "Interrupted"), ("StepError", "Failed")])
def test_numbers_of_a_run_that_did_not_end_are_reported_as_not_computed(line_run, tmp_path, kind, state):
    folder = tmp_path / "stopped"
    shutil.copytree(line_run, folder)
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    kept = {key: summary[key] for key in ("title", "config", "run", "parameters", "provenance")}
    kept["error"] = {"kind": kind, "message": "stopped"}
    (folder / "summary.json").write_text(json.dumps(kept), encoding="utf-8")
    text = report([folder])
    assert headline(text).startswith(state)
    assert "docking: not computed, since the run did not come to its end." in words(text)
    assert "names no measures" not in text


def test_the_page_loads_nothing(line_run):
    text = re.sub(r"<script.*?</script>", "", report([line_run]), flags=re.S)
    assert not re.search(r"(?:src|href)\s*=\s*[\"']?(?!#|data:|[\"'])", re.sub(r"xlink:href=\"#", "", text))
    assert "default-src 'none'" in text


def row(text: str, key: str) -> list[float]:
    """The numbers of a table's row, as they are."""
    cells = re.search(rf'<tr data-key="{re.escape(key)}">(.*?)</tr>', text)[1]
    return [float(one) for one in re.findall(r'data-value="([^"]*)"', cells)]


def test_a_paced_run_tells_how_well_it_kept_to_the_clock(paced_run, line_run):
    text = report([paced_run])
    summary = json.loads((paced_run / "summary.json").read_text(encoding="utf-8"))
    reported = summary["run"]["realtime"]
    assert row(text, "realtime.steps") == [reported["steps"]] == [1000]
    assert row(text, "realtime.missed") == [reported["missed"]]
    assert row(text, "realtime.time_per_step") == [0.05]
    assert row(text, "realtime.worst_miss") == pytest.approx([1e3 * reported["worst_miss"]], rel=1e-3)
    for key, name in (("latency", "from deadline to begin of step"), ("busy", "from begin to end of step")):
        expected = [1e3 * reported[key][one] for one in ("median", "p99", "p999", "max")]
        assert row(text, f"realtime.{name}") == pytest.approx(expected, rel=1e-3)
        counts = re.search(rf"{name}, above \[ms\].*?</table>", text, re.S)[0]
        steps = re.findall(r'data-value="(\d+)"', counts)
        assert sum(map(int, steps)) == sum(reported[key]["histogram"]["counts"]) == 1000
    drawn = re.search(r'<figure id="figure-realtime">(.*?)</figure>', text, re.S)[1]
    assert f"{reported['missed']} of 1000 deadlines missed" in words(drawn)
    assert "Real time" not in words(report([line_run]))


def test_the_energy_at_the_couplings_is_drawn_as_recorded(line_run, tmp_path):
    text = report([line_run])
    recorded = read_results(line_run / "coupling.csv")
    kept = held(text)
    for name in recorded.signals:
        assert decoded(kept["arrays"][f"coupling/{name}"]) == pytest.approx(recorded[name], rel=1e-6)
    created, exchanged = (
        one for one in kept["charts"] if one["unit"] == "J" and one["title"][:6] == "Energy"
    )
    assert [one["y"] for one in created["series"]] == ["coupling/contact-satellite.created"]
    assert [one["label"].rpartition(".")[2] for one in exchanged["series"]] == ["taken", "given"]
    summary = json.loads((line_run / "summary.json").read_text(encoding="utf-8"))
    bond = summary["coupling"]["contact-satellite"]
    last = decoded(kept["arrays"]["coupling/contact-satellite.created"])[-1]
    assert last == pytest.approx(bond["created"], rel=1e-6)
    without = tmp_path / "without"
    shutil.copytree(line_run, without)
    (without / "coupling.csv").unlink()
    assert "Energy created by the coupling" not in words(report([without]))
    (without / "coupling.csv").write_text("nonsense", encoding="utf-8")
    assert "coupling.csv: no results can be read from it" in words(report([without]))


def test_the_datagrams_of_another_program_are_reported():
    times = {"count": 3, "median": 0.001, "p99": 0.002, "p999": 0.002, "max": 0.0025}
    link = {"sent": 5, "received": 4, "lost": 1, "age": times, "round_trip": times}
    text = "".join(punctuality({"external": {"rig": link}}, "x"))
    assert row(text, "external.rig.lost") == [1]
    assert row(text, "external.rig.round trip") == [1.0, 2.0, 2.0, 2.5]
    assert punctuality({"steps": 5}, "x") == []


def test_the_graph_shows_ports_units_and_effects(line_run):
    text = report([line_run])
    graph = re.search(r"<div class=graph>(.*?)</div>", text, re.S)[1]
    for one in ("satellite", "RobotResponse", "force [N]", "command", "delay 1 ms"):
        assert one in words(graph)
    assert len(re.findall(r'class="tip"', graph)) == 4


def crossed(drawing) -> list[tuple[str, tuple]]:
    """Boxes that a wire runs through."""
    found = []
    for net in drawing.nets:
        for line in net.lines:
            for (x0, y0), (x1, y1) in itertools.pairwise(line):
                for name, box in drawing.boxes.items():
                    if (
                        min(x0, x1) < box.x + box.node.width - 0.5
                        and max(x0, x1) > box.x + 0.5
                        and min(y0, y1) < box.y + box.node.height
                        and max(y0, y1) > box.y
                    ):
                        found.append((name, (x0, y0, x1, y1)))
    return found


@pytest.mark.parametrize("seed", range(30))
def test_no_wire_crosses_a_box(seed):
    random = np.random.default_rng(seed)
    count = int(random.integers(2, 9))
    ends = [tuple(map(int, random.integers(0, count, 2))) for _ in range(int(random.integers(1, 16)))]
    wires = [Wire((f"n{a}", f"o{i % 3}"), (f"n{b}", f"i{i}")) for i, (a, b) in enumerate(ends)]
    nodes = [
        Node(
            f"n{n}",
            "kind",
            {w.target[1]: w.target[1] for w in wires if w.target[0] == f"n{n}"},
            {w.source[1]: w.source[1] for w in wires if w.source[0] == f"n{n}"},
        )
        for n in range(count)
    ]
    drawing = lay_out(nodes, wires)
    assert crossed(drawing) == []
    assert sum(len(net.lines) for net in drawing.nets) == len(wires)
    for net in drawing.nets:
        for line in net.lines:
            assert all(0 <= x <= drawing.width and 0 <= y <= drawing.height for x, y in line)
            assert all(a[0] == b[0] or a[1] == b[1] for a, b in itertools.pairwise(line))


def test_every_bundled_system_can_be_drawn():
    from orchestrator.fmi import bundled

    for name in bundled.system_names():
        model = load_config(name).model
        assert draw_graph(model, {}).count("data-instance=") == len(model.instances) + len(model.external)


def test_a_folder_of_runs_is_compared_and_bad_ones_are_refused(line_run, tmp_path, capsys):
    for name in ("a", "b"):
        shutil.copytree(line_run, tmp_path / "runs" / name)
    page = tmp_path / "page.html"
    assert main(["report", str(tmp_path / "runs"), "-o", str(page)]) == 0
    assert headline(page.read_text(encoding="utf-8")) == "2 runs, all done."
    assert f"Written: {page}" in capsys.readouterr().out
    (tmp_path / "empty").mkdir()
    assert main(["report", str(tmp_path / "empty"), str(tmp_path / "none")]) == 2
    reported = capsys.readouterr().err
    assert "empty: holds no run" in reported and "none: is no folder" in reported
    with pytest.raises(ConfigError, match="several runs are called"):
        report([tmp_path / "runs" / "a", tmp_path / "runs"])
    assert main(["report", str(line_run), "--size", "0"]) == 2


def test_what_a_page_leaves_out_of_a_folder_is_reported(line_run, tmp_path, capsys):
    folder = tmp_path / "multi"
    shutil.copytree(line_run, folder)
    for name in ("a", "b"):
        shutil.copytree(line_run, folder / name)
    (folder / "diagnosis.json").write_text("{}", encoding="utf-8")
    (folder / "report.html").write_text("the diagnosis' page", encoding="utf-8")
    (folder / "reproduction.json").write_text("{}", encoding="utf-8")
    assert main(["report", str(folder)]) == 0
    reported = capsys.readouterr().out.splitlines()
    assert reported[0].startswith(f"Written: {folder / 'runs.html'}")
    expected = [
        f"{folder} also holds a diagnosis: see {folder / 'report.html'}",
        f"{folder} also holds a reproduction: see {folder / 'reproduction.html'}",
        f"{folder} also holds runs in folders (a, b): "
        f"see `orchestrator report {folder / 'a'} {folder / 'b'}`",
    ]
    assert reported[1:] == [f"left out: {one}" for one in expected]
    text = words((folder / "runs.html").read_text(encoding="utf-8"))
    assert "Done: 2 s in 4000 steps" in text and all(one in text for one in expected)
    assert (folder / "report.html").read_text(encoding="utf-8") == "the diagnosis' page"
    page = words(report([folder, folder / "a"]))
    assert "2 runs, all done" in page and "also holds runs in folders (b)" in page
    (folder / "config.yaml").unlink()
    assert "2 runs, all done" in words(report([folder]))  # those in its folders


def test_a_reproduction_leaves_a_run_in_its_folder_alone(line_run, tmp_path):
    from orchestrator.cli.reproduce import write
    from orchestrator.docking.reproduction.reproduce import Reproduction

    folder = tmp_path / "out"
    shutil.copytree(line_run, folder)
    before = (folder / "summary.json").read_bytes()
    counts = {"agree": 0, "differ": 0}
    summary = {"reference": "x", "runs": 0, "wall_time": 0.0, "figures": [], "experiments": [], "numbers": 0}
    write(Reproduction(summary | {"source": counts, "theory": counts}, {}), folder)
    assert (folder / "summary.json").read_bytes() == before
    assert headline(report([folder])).startswith("Done: 2 s")


def sweep(rows) -> SweepTable:
    return SweepTable("abc", "delays", {"robot.tau_m": "s"}, ["peak"], rows, {})


def test_a_sweep_shows_its_points_ranges_and_failures():
    rows = [
        {"point": 0, "robot.tau_m": 0.002, "status": "done", "peak": 140.25, "peak.change": 0.5},
        {"point": 1, "robot.tau_m": 0.004, "status": "done", "peak": 180.5, "peak.change": -0.75},
        {"point": 2, "robot.tau_m": 0.006, "status": "failed", "kind": "crash", "message": "x < 1\nmore"},
        {"point": 3, "robot.tau_m": 0.008, "status": None},
    ]
    text = page_of_tables("runs", [sweep(rows)])
    assert headline(text) == "4 points: 2 done, 1 failed, 1 not run yet."
    ranges = re.search(r'<tr data-key="range.peak">(.*?)</tr>', text)[1]
    assert re.findall(r'data-value="([^"]*)"', ranges) == ["140.25", "0", "180.5", "1", "0.75"]
    assert "<td>crash</td>" in text and "<td>x &lt; 1</td>" in text
    arrays = held(text)["arrays"]
    assert decoded(arrays["abc/peak/robot.tau_m/0/x"]).tolist() == [0.002, 0.004]
    assert decoded(arrays["abc/peak/robot.tau_m/0/y"]).tolist() == [140.25, 180.5]


def test_a_store_without_studies_has_a_page():
    assert headline(page_of_tables("runs", [])) == "The store holds no study yet."


def test_the_page_of_a_store_has_the_stores_numbers(tmp_path):
    reading = pytest.importorskip("orchestrator.campaign.database", reason="DuckDB is not installed")
    study = tmp_path / "study.yaml"
    study.write_text(
        "format: sweep/1\ntitle: delays\nsystem: docking-1d-uncompensated\n"
        "set: {run.stop_time: 0.5 s, run.step_size: 1 ms}\nstep_halving: false\n"
        "design:\n  grid:\n    robot.tau_m: [2 ms, 6 ms]\n"
        "derived: {peak: max(abs(contact.force))}\n",
        encoding="utf-8",
    )
    assert main(["sweep", str(study), "--store", str(tmp_path / "store"), "--quiet"]) == 0
    with reading.Store(tmp_path / "store") as store:
        rows = store.table().to_pylist()
    text = report([tmp_path / "store"])
    assert headline(text) == "2 points: 2 done, 0 failed."
    for row in rows:
        reported = re.search(rf'<tr data-key="point.{row["point"]}.0">(.*?)</tr>', text, re.S)[1]
        assert (
            f'data-value="{row["peak"]!r}"' in reported and f'data-value="{row["robot.tau_m"]!r}"' in reported
        )
