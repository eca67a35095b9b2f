"""The store: whole after a kill at any moment, readable on a full disk, and read while it is written."""

from __future__ import annotations

import json
import os
import random
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from campaign_bench import quick
from extent import all_or
from hypothesis import given, settings
from hypothesis import strategies as st

from orchestrator.base.errors import ConfigError
from orchestrator.campaign import Store, Study
from orchestrator.campaign.journal import Journal, read_journal
from orchestrator.campaign.store import StoreWriter, journals, parts
from orchestrator.config import load_config

HERE = Path(__file__).parent
posix = pytest.mark.skipif(os.name != "posix", reason="kills and limits of POSIX")

# After its first runs it slows down: it is not to be over before it is killed, whatever the machine's speed.
_SWEEP = """
import sys, time
sys.path[:0] = [{here!r}, {root!r}]
from campaign_bench import quick
study = quick(design={{"grid": {{"robot.tau_m": {{"from": "4 ms", "to": "12 ms", "count": 40}}}}}})
reported = []
def progress(done, of, failed):
    print(done, flush=True)
    reported.append(done)
    time.sleep(0.2 if len(reported) > 4 else 0.0)
study.run({store!r}, jobs=1, progress=progress)
"""


@settings(max_examples=60, deadline=None)
@given(
    records=st.lists(st.tuples(st.binary(max_size=50), st.binary(max_size=200)), max_size=8),
    cut=st.integers(0, 3000),
    flip=st.booleans(),
)
def test_a_journal_reads_back_up_to_its_last_whole_record(records, cut, flip, tmp_path_factory):
    path = tmp_path_factory.mktemp("journal") / "1.log"
    journal, ends = Journal(path), [0]
    for text, data in records:
        journal.append(text, data)
        ends.append(journal.size)
    journal.close()
    content = bytearray(path.read_bytes())
    assert len(content) == ends[-1]
    assert list(read_journal(path)) == records
    cut = min(cut, len(content))
    if flip and cut < len(content):
        content[cut] ^= 255
    else:
        content = content[:cut]
    path.write_bytes(content)
    whole = sum(end <= cut for end in ends[1:])
    assert list(read_journal(path)) == records[:whole]


def test_a_journal_goes_on_after_a_write_that_failed(tmp_path, monkeypatch):
    journal = Journal(tmp_path / "1.log")
    journal.append(b"one", b"1")
    write = os.write

    def full(file, data):
        write(file, bytes(data)[:10])
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "write", full)
        with pytest.raises(OSError, match="No space left"):
            journal.append(b"two" * 100)
    assert (tmp_path / "1.log").stat().st_size == journal.size
    journal.append(b"three", b"3")
    journal.close()
    assert list(read_journal(tmp_path / "1.log")) == [(b"one", b"1"), (b"three", b"3")]
    assert (tmp_path / "1.log").stat().st_size == journal.size


def _row(value):
    return {"kind": "", "derived": {"x": value}, "numbers": {"n": value}}


def test_rows_are_read_from_journals_and_parts_alike(tmp_path):
    store = tmp_path / "store"
    with StoreWriter(store) as writer:
        writer.begin("s1", {"study": "a", "created": "", "about": "{}"})
        for n in range(5):
            writer.add(f"r{n}", _row(n / 3), 1, 0.1, b"")
        assert len(journals(store)) == 1 and not parts(store)
        with Store(store) as reader:
            before = reader.query("select run, x from runs order by run").to_pylist()
    assert not journals(store) and len(parts(store)) == 1
    with Store(store) as reader:
        assert reader.query("select run, x from runs order by run").to_pylist() == before
        assert reader.query("select value from numbers where run = 'r1'").to_pylist() == [{"value": 1 / 3}]
    assert [one["x"] for one in before] == [n / 3 for n in range(5)]


def test_a_part_counts_where_its_journal_is_still_there(tmp_path):
    store = tmp_path / "store"
    with StoreWriter(store) as writer:
        writer.begin("s1", {"study": "a", "created": "", "about": "{}"})
        writer.add("r0", _row(1.0), 1, 0.1, b"")
        (path,) = journals(store)
        content = path.read_bytes()
    path.write_bytes(content)  # as if the process had been killed before it removed it
    (store / "parts" / ".000009").mkdir()  # and as it was making another
    with Store(store) as reader:
        assert reader.query("select count(*) as n from _runs").to_pylist() == [{"n": 1}]
    with StoreWriter(store) as writer:
        assert writer.seen() == {"r0": False}
    assert not journals(store) and len(parts(store)) == 1
    assert not list((store / "parts").glob(".*"))


def test_many_runs_turn_into_several_parts(tmp_path, monkeypatch):
    monkeypatch.setattr("orchestrator.campaign.store._MOST", 10)
    with StoreWriter(tmp_path / "store") as writer:
        writer.begin("s1", {"study": "a", "created": "", "about": "{}"})
        for n in range(35):
            writer.add(f"r{n}", _row(float(n)), 1, 0.1, b"")
            with Store(tmp_path / "store") as reader:
                assert reader.query("select count(*) as n, sum(x) as s from runs").to_pylist() == [
                    {"n": n + 1, "s": n * (n + 1) / 2}
                ]
    assert len(parts(tmp_path / "store")) == 4


def test_a_folder_with_other_things_is_no_store(tmp_path):
    (tmp_path / "thesis.tex").write_text("x")
    with pytest.raises(ConfigError, match="is not empty, and no store"):
        StoreWriter(tmp_path)
    with pytest.raises(ConfigError, match="is not a store of runs"):
        Store(tmp_path)
    assert [one.name for one in tmp_path.iterdir()] == ["thesis.tex"]


@posix
def test_kills_at_random_moments_cost_nothing_but_time(tmp_path):
    study = quick(design={"grid": {"robot.tau_m": {"from": "4 ms", "to": "12 ms", "count": 40}}})
    expected = study.run(tmp_path / "undisturbed", jobs=1).table
    store = tmp_path / "store"
    draw = random.Random(20)
    code = _SWEEP.format(here=str(HERE), root=str(HERE.parents[1]), store=str(store))
    wanted, kills = all_or(5, 20), 0
    for _ in range(wanted):
        process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
        if draw.random() < 0.75:
            # After some of the lines that it prints: among the runs.
            for _ in range(draw.randint(1, 3)):
                process.stdout.readline()
            time.sleep(draw.uniform(0.0, 0.02))
        else:
            time.sleep(draw.uniform(0.0, 1.5))
        if process.poll() is None:
            process.send_signal(signal.SIGKILL)
            kills += 1
        process.communicate()
    assert kills >= 0.75 * wanted - 1
    swept = study.run(store, jobs=1)
    assert swept.made + swept.reused == 40
    assert swept.table.equals(expected)
    with Store(store) as reader, Store(tmp_path / "undisturbed") as other:
        assert reader.query("select count(*) as n from _runs").to_pylist() == [{"n": 40}]
        # Several of the sweeps that were killed had made some of the runs.
        sessions = reader.query("select count(distinct session) as n from runs").to_pylist()[0]["n"]
        assert sessions >= all_or(2, 4)
        numbers = "select run, name, value from numbers order by run, name"
        assert reader.query(numbers).equals(other.query(numbers))
    assert not journals(store)


@posix
def test_a_full_disk_is_reported_and_the_store_stays_readable(tmp_path):
    store = tmp_path / "store"
    grid = {"grid": {"robot.tau_m": {"from": "4 ms", "to": "12 ms", "count": 30}}}
    expected = quick(design=grid, record="all").run(tmp_path / "undisturbed", jobs=1).table
    code = f"""
import sys
sys.path[:0] = [{str(HERE)!r}, {str(HERE.parents[1])!r}]
from campaign_bench import quick
from orchestrator.base.errors import OrchestratorError
try:
    quick(design={grid!r}, record="all").run({str(store)!r}, jobs=1)
except OrchestratorError as error:
    print(error)
    sys.exit(1)
"""
    with StoreWriter(store) as writer:  # FMUs are larger than what the limit leaves to a file
        writer.put(quick(design=grid).files)
    ended = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000)),
        env={**os.environ, "TMPDIR": str(tmp_path)},
    )
    assert ended.returncode == 1, ended.stderr
    first, second = ended.stdout.splitlines()[:2]
    assert first.startswith(f"{store}: no more runs can be kept: the disk is full (")
    assert second == "  Make room and start again: it goes on where it stopped."
    with Store(store) as reader:
        kept = reader.query("select count(*) as n from runs").to_pylist()[0]["n"]
        assert 0 < kept < 30
        assert reader.query("select count(distinct run) as n from trajectories").to_pylist() == [{"n": kept}]
    swept = quick(design=grid, record="all").run(store, jobs=1)
    assert swept.reused == kept
    assert swept.table.equals(expected)


_COMPACT = """
import resource, sys
sys.path[:0] = [{root!r}]
from orchestrator.campaign import store
from orchestrator.base.errors import OrchestratorError
store._MOST = 8
try:
    with store.StoreWriter(store.Path({folder!r})) as writer:
        writer.begin("s1", {{"study": "a", "created": "", "about": "{{}}"}})
        resource.setrlimit(resource.RLIMIT_FSIZE, ({most}, {most}))
        for n in range(20):
            derived = {{f"x{{k}}": float(n) for k in range(60)}}
            writer.add(f"r{{n:02d}}", {{"kind": "", "derived": derived}}, 1, 0.1, b"")
            print(n, flush=True)
except OrchestratorError as error:
    print(error)
    sys.exit(1)
"""


def _compacting(folder, most):
    """Adds runs on a disk that takes so many bytes in a file; every ninth record makes a part."""
    code = _COMPACT.format(root=str(HERE.parents[1]), folder=str(folder), most=most)
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)


def _values(folder):
    with Store(folder) as reader:
        return reader.query("select run, x0, x59 from runs order by run").to_pylist()


@posix
def test_a_disk_that_is_full_when_a_part_is_made_loses_nothing(tmp_path):
    unlimited, store = tmp_path / "unlimited", tmp_path / "store"
    assert _compacting(unlimited, -1).returncode == 0
    expected = _values(unlimited)
    assert [one["x59"] for one in expected] == [float(n) for n in range(20)]
    # A part of a few runs with many quantities is larger than their journal: the disk takes the latter.
    part = (parts(unlimited)[0] / "runs.parquet").stat().st_size
    ended = _compacting(store, part // 2)
    assert ended.returncode == 1, ended.stderr
    *kept, first, second = ended.stdout.splitlines()
    assert kept == [str(n) for n in range(7)], "the run that made the journal long enough is written, too"
    assert first.startswith(f"{store}: no more runs can be kept: the disk is full (")
    assert first.endswith("; what was kept until then can be read")
    assert second == "  Make room and start again: it goes on where it stopped."
    assert not list((store / "parts").iterdir()), "nothing half made is left"
    assert [one.stat().st_size < part // 2 for one in journals(store)] == [True]
    assert _values(store) == expected[:8]
    # As long as there is no room it is reported again, and nothing is lost by trying.
    assert "the disk is full" in _reported_when_opened(store, part // 2)
    assert _values(store) == expected[:8]
    with StoreWriter(store) as writer:
        assert writer.seen() == dict.fromkeys((f"r{n:02d}" for n in range(8)), False)
    assert not journals(store) and len(parts(store)) == 1
    assert _values(store) == expected[:8]


def _reported_when_opened(store, most):
    code = f"""
import resource, sys
sys.path[:0] = [{str(HERE.parents[1])!r}]
from pathlib import Path
from orchestrator.campaign.store import StoreWriter
resource.setrlimit(resource.RLIMIT_FSIZE, ({most}, {most}))
StoreWriter(Path({str(store)!r}))
"""
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stderr


@posix
def test_a_disk_that_is_full_at_the_end_leaves_the_journal(tmp_path):
    store = tmp_path / "store"
    with StoreWriter(store) as writer:
        writer.begin("s1", {"study": "a", "created": "", "about": "{}"})
        for n in range(3):
            writer.add(f"r{n}", _row(n / 3), 1, 0.1, b"")
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
        try:
            writer.close()
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert len(journals(store)) == 1 and not parts(store)
    with Store(store) as reader:
        assert reader.query("select x from runs order by run").column("x").to_pylist() == [0.0, 1 / 3, 2 / 3]


def test_a_store_that_cannot_be_written_is_reported(tmp_path):
    (tmp_path / "store").write_text("a file")
    with pytest.raises(ConfigError, match="store: is a file"):
        StoreWriter(tmp_path / "store")


def test_what_ran_is_kept_with_it(tmp_path):
    study = quick(design={"grid": {"robot.tau_m": ["4 ms"]}})
    study.run(tmp_path / "store", jobs=1)
    with Store(tmp_path / "store") as store:
        (session,) = store.query("select * from sessions").to_pylist()
        about = json.loads(session["about"])
        assert about["packages"]["orchestrator"] and about["python"] and about["product"]
        assert about["fmus"] == sorted(study.files)
        assert all((tmp_path / "store" / "files" / one).is_file() for one in about["fmus"])
        (kept,) = store.studies.values()
        assert kept["study"]["design"] == {"grid": {"robot.tau_m": ["4 ms"]}}
        assert kept["axes"] == {"robot.tau_m": "s"}


def _two_masses(**changes):
    """Two bodies whose names differ in case only."""
    body = {"fmu": "SatelliteDynamics", "form": "native", "start": {"force": "0 N"}}
    values = {
        "system": {
            "run": {"master": "gauss-seidel", "step_size": "10 ms", "stop_time": "0.1 s"},
            "instances": {"m": body, "M": body},
        },
        "design": {"grid": {"m.mass": ["100 kg", "200 kg"], "M.mass": ["1 kg", "2 kg"]}},
        "derived": {"total": "m.mass + M.mass"},
        "step_halving": False,
    }
    return Study(values | changes)


def test_axes_that_differ_in_case_are_kept_apart(tmp_path):
    columns = _two_masses().run(tmp_path / "store", jobs=1).columns()
    assert columns["m.mass"].tolist() == [100.0, 100.0, 200.0, 200.0]
    assert columns["M.mass"].tolist() == [1.0, 2.0, 1.0, 2.0]
    assert columns["total"].tolist() == [101.0, 102.0, 201.0, 202.0]


def test_quantities_of_two_studies_may_differ_in_case(tmp_path):
    grid = {"grid": {"m.mass": ["100 kg", "200 kg"]}}
    studies = [
        _two_masses(design=grid, derived={name: text})
        for name, text in (("Twice", "2*m.mass"), ("twice", "m.mass"))
    ]
    swept = [one.run(tmp_path / "store", jobs=1) for one in studies]
    assert swept[0].columns()["Twice"].tolist() == [200.0, 400.0]
    assert swept[1].columns()["twice"].tolist() == [100.0, 200.0]
    with StoreWriter(tmp_path / "store") as writer:  # a journal beside the parts
        writer.begin("s1", {"study": "a", "created": "", "about": "{}"})
        writer.add("r0", {"kind": "", "derived": {"TWICE": 1.0}}, 1, 0.1, b"")
        assert swept[0].columns()["Twice"].tolist() == [200.0, 400.0]


def test_a_study_is_read_alike_whatever_else_the_store_holds(tmp_path):
    system = load_config("docking-1d-uncompensated").model.to_data()
    limit = {
        "from": "contact.force",
        "to": "satellite.force",
        "through": [{"saturate": {"high": "100 N", "low": "-100 N"}}],
    }
    number = next(n for n, one in enumerate(system["connections"]) if str(one).endswith("-> satellite.force"))
    system["connections"][number] = limit
    system.pop("bonds", None)
    path = f"connections[{number}].through[0].saturate.high"
    first = quick(system=system, design={"grid": {path: ["100 N", "200 N"]}}).run(tmp_path / "store", jobs=1)
    before = first.table
    assert first.columns()[path].tolist() == [100.0, 200.0]
    quick(system=system, design={"grid": {path: ["100 N", "inf N"]}}).run(tmp_path / "store", jobs=1)
    assert first.table.equals(before)
