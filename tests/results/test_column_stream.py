"""Results on disk: whole blocks whatever happens to who writes them, and no memory that grows with a run."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
import tracemalloc
from fractions import Fraction
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from assembled import assemble
from doubles import mass, spring
from unruly import unruly_fmu

from orchestrator.base.errors import OrchestratorError
from orchestrator.cli.main import main
from orchestrator.fmi import load_fmu
from orchestrator.master import create_master
from orchestrator.results import column_stream as stream
from orchestrator.results import recorded_signals as recorded
from orchestrator.results.column_stream import StreamedColumns, StreamWriter
from orchestrator.results.recorders import Recorder, Results, read_results
from orchestrator.simulation.grid import Grid
from orchestrator.simulation.loop import simulate
from orchestrator.simulation.run import run
from orchestrator.system.assembly import Part

pytest.importorskip("numba")
# The docking FMUs bring a pythonfmu of their own, without what building takes: find the installed one first.
pytest.importorskip("pythonfmu")

TYPES = {"time": "f8", "number": "f8", "count": "i8", "flag": "?", "other": "f8"}


def columns(begin: int, end: int) -> list[np.ndarray]:
    index = np.arange(begin, end, dtype=float)
    return [index / 3, -index, index * 2, index % 3 == 0, np.sqrt(index)]


def written(path: Path, *ends: int, close: bool = True) -> Path:
    """A file with a block up to each of these rows; numbers all as doubles, as a recorder has them."""
    writer = StreamWriter(path, TYPES, {"number": "m"}, {"about": "this"})
    for begin, end in zip((0, *ends), ends, strict=False):
        first, *others = columns(begin, end)
        writer.write(first, np.array(others, dtype=float))
    if close:
        writer.close()
    return path


@pytest.mark.parametrize("rows", [3, 512])
@pytest.mark.filterwarnings("error")
def test_whole_numbers_as_large_as_their_type_are_written_as_such(rows, tmp_path):
    path = tmp_path / "x.arrow"
    writer = StreamWriter(path, {"time": "f8", "signed": "i8", "unsigned": "u8"}, {}, {})
    signed, unsigned = np.full(rows, -(2.0**63)), np.zeros(rows)
    signed[1:], unsigned[1:] = 2.0**63, 2.0**64  # the nearest float to the largest number is beyond it
    writer.write(np.arange(rows, dtype=float), np.array([signed, unsigned]))
    writer.close()
    found = StreamedColumns(path)
    assert found["signed"][:3].tolist() == [-(2**63), 2**63 - 1, 2**63 - 1]
    assert found["unsigned"][:3].tolist() == [0, 2**64 - 1, 2**64 - 1]


@pytest.mark.parametrize("ends", [(), (1,), (512,), (512, 1024, 1031, 1543), (4096, 5000, 5000, 9096)])
def test_blocks_of_any_size_read_back(ends, tmp_path):
    """Blocks of a multiple of 512 rows are put together by ourselves, others by pyarrow."""
    found = StreamedColumns(written(tmp_path / "x.arrow", *ends))
    rows = ends[-1] if ends else 0
    assert found.rows == rows and list(found) == list(TYPES)
    for (name, kind), expected in zip(TYPES.items(), columns(0, rows), strict=True):
        assert found[name].dtype == np.dtype(kind) and np.array_equal(found[name], expected)
    assert found.units["number"] == "m" and found.metadata == {"about": "this"}
    with pytest.raises(KeyError):
        found["nothing"]


def test_any_reader_of_arrow_streams_reads_it(tmp_path):
    import pyarrow as pa

    with pa.OSFile(str(written(tmp_path / "x.arrow", 512, 600))) as file:
        table = pa.ipc.open_stream(file).read_all()
    table.validate(full=True)
    assert table.num_rows == 600 and table.column("flag").to_pylist() == columns(0, 600)[3].tolist()


def test_whatever_is_cut_off_whole_blocks_remain(tmp_path):
    ends = (3, 7, 519)
    whole = written(tmp_path / "x.arrow", *ends, close=False).read_bytes()
    sizes = [len(written(tmp_path / "y.arrow", *ends[:n], close=False).read_bytes()) for n in range(4)]
    cut = tmp_path / "cut.arrow"
    steps = [*range(sizes[0], sizes[2] + 400), *range(sizes[2] + 400, sizes[3] + 1, 97), sizes[3]]
    for size in steps:
        cut.write_bytes(whole[:size])
        blocks = sum(size >= one for one in sizes) - 1
        found = StreamedColumns(cut)
        assert found.rows == (0, *ends)[blocks]
        assert np.array_equal(found["number"], columns(0, found.rows)[1])
    for size in (0, 1, sizes[0] // 2):
        cut.write_bytes(whole[:size])
        with pytest.raises(OrchestratorError, match=r"cut\.arrow: no results can be read from it"):
            read_results(cut)


def test_a_second_run_does_not_touch_what_was_read_from_the_first(tmp_path, monkeypatch):
    monkeypatch.setattr(recorded, "_SMALL", 0)
    path = written(tmp_path / "x.arrow", 4096)
    found = StreamedColumns(path)
    written(path, 3)
    assert np.array_equal(found["other"], columns(0, 4096)[4])


def oscillator():
    return assemble(
        [Part("mass", mass(), {"position": "1 m"}), Part("spring", spring())],
        ["mass.position -> spring.position", "spring.force -> mass.force"],
    )


class Full(BytesIO):
    """A disk that is full after so many bytes."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.left = size

    def write(self, data) -> int:
        taken = super().write(data[: self.left])
        self.left -= taken
        if not taken:
            raise OSError(28, "No space left on device")
        return taken


def test_a_full_disk_ends_the_run_and_leaves_what_was_written(tmp_path):
    file = Full(100_000)
    recorder = Recorder(oscillator(), path=file)
    with pytest.raises(OrchestratorError, match=r"can no longer be written .*No space left on device"):
        simulate(
            oscillator(), create_master("jacobi"), Grid(Fraction(0), Fraction(1, 1000), 9000), [recorder]
        )
    recorder.close()
    (tmp_path / "x.arrow").write_bytes(file.getvalue())
    assert file.tell() == 100_000 and len(read_results(tmp_path / "x.arrow")) == 3 * 1024


def test_large_results_are_read_column_by_column(tmp_path, monkeypatch):
    """The same summary, figures and files, whether columns are in memory or on disk."""
    made = []
    for small in (1 << 30, 0):
        monkeypatch.setattr(recorded, "_SMALL", small)
        out = tmp_path / str(small)
        result = run(
            "docking-1d", out=out, overrides=["run.stop_time=0.4 s"], formats=("csv", "parquet", "mat")
        )
        assert isinstance(result.results._columns, StreamedColumns if small == 0 else dict)
        files = {path.name: path.read_bytes() for path in out.iterdir() if path.suffix in (".csv", ".png")}
        numbers = {
            suffix: {name: c.tolist() for name, c in read_results(out / f"results.{suffix}").signals.items()}
            for suffix in ("arrow", "csv", "parquet", "mat")
        }
        summary = json.loads((out / "summary.json").read_text())
        assert numbers["arrow"] == numbers["csv"] == numbers["parquet"] == numbers["mat"]
        made.append((files, numbers, summary["contacts"], summary["numerics"], summary["parameters"]))
    assert made[0] == made[1]


def test_what_nobody_holds_is_forgotten(tmp_path):
    results = Results.streamed(StreamedColumns(written(tmp_path / "x.arrow", 4096)))
    assert results["number"] is results["number"]  # small: kept
    columns_on_disk = StreamedColumns(tmp_path / "x.arrow")
    held = columns_on_disk["number"]
    assert columns_on_disk["number"] is held
    del held
    assert not columns_on_disk._held


def test_chunks_are_the_same_from_memory_and_disk(tmp_path, monkeypatch):
    monkeypatch.setattr(recorded, "_SMALL", 0)
    path = written(tmp_path / "x.arrow", 512, 1024, 1031, 1543)
    time, *others = columns(0, 1543)
    in_memory = Results(time, dict(zip(list(TYPES)[1:], others, strict=True)))
    for rows in (1, 100, 512, 1543, 5000):
        pairs = list(
            zip(Results.streamed(StreamedColumns(path)).chunks(rows), in_memory.chunks(rows), strict=True)
        )
        assert len(pairs) == -(-1543 // rows)
        for one, other in pairs:
            assert list(one) == list(other) and all(np.array_equal(one[name], other[name]) for name in one)


# Killed.


SYSTEM = """
run: {master: jacobi, step_size: 1 ms, stop_time: 3 h}
instances:
  one: {fmu: FMU, start: {rate: 0.1 m}}
  two: {fmu: FMU}
connections: [one.level -> two.rate]
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="sends a POSIX signal")
@pytest.mark.parametrize("loop", ["python", "native"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_killed_run_leaves_readable_results(loop, seed, tmp_path, capsys):
    fmu = unruly_fmu(2, "m", "m")
    config, out = tmp_path / "tanks.yaml", tmp_path / "out"
    config.write_text(SYSTEM.replace("FMU", str(fmu)), encoding="utf-8")
    process = subprocess.Popen(
        [sys.executable, "-m", "orchestrator", "run", str(config), "--out", str(out), "--set",
         f"run.loop={loop}", "--quiet"],
        cwd=Path(__file__).parents[2], env={**os.environ},
    )  # fmt: skip
    file, deadline = out / "results.arrow", time.monotonic() + 60.0
    least = random.Random(seed).randrange(20_000, 2_000_000 if loop == "native" else 300_000)
    while time.monotonic() < deadline and not (file.is_file() and file.stat().st_size > least):
        time.sleep(0.005)
    process.kill()
    assert process.wait() == -signal.SIGKILL
    assert not (out / "summary.json").exists()
    results = read_results(out)
    rows = len(results)
    assert rows > 100 and results.parameters["one.rate"] == 0.1 and results.provenance["fmus"]["one"]
    system = assemble(
        [Part("one", load_fmu(fmu), {"rate": "0.1 m"}), Part("two", load_fmu(fmu))],
        ["one.level -> two.rate"],
    )
    expected = Recorder(system)
    grid = Grid(Fraction(0), Fraction(1, 1000), rows)
    simulate(system, create_master("jacobi"), grid, [expected], loop="native")
    for name, column in expected.results().signals.items():
        assert np.array_equal(results[name], column[:rows]), name
    assert main(["export-results", str(out), "--format", "csv"]) == 0
    assert capsys.readouterr().out == f"{rows} rows written to {out}: results.csv\n"
    assert len((out / "results.csv").read_text().splitlines()) == rows + 1


# Wide files.


def wide(path, width, rows=8):
    """A file of so many columns, whose number stands in them."""
    writer = StreamWriter(path, {"time": np.float64, **{f"c{n}": np.float64 for n in range(width)}}, {})
    writer.write(np.arange(rows, dtype=float), np.repeat(np.arange(width, dtype=float)[:, None], rows, 1))
    writer.close()
    return path


@pytest.fixture
def passes(monkeypatch):
    """How often a file of columns was gone through."""
    seen = []
    reader = StreamedColumns._reader

    def counted(self, numbers):
        seen.append(numbers)
        return reader(self, numbers)

    monkeypatch.setattr(StreamedColumns, "_reader", counted)
    return seen


@pytest.mark.parametrize("width", [40, 2000])
def test_columns_in_order_take_few_passes(width, tmp_path, passes):
    found = StreamedColumns(wide(tmp_path / "x.arrow", width))
    for number, name in enumerate(name for name in found if name != "time"):
        assert np.array_equal(found[name], np.full(8, number))
    assert len(passes) <= 3 + np.log2(width)


def test_columns_in_any_order_are_right(tmp_path):
    found = StreamedColumns(wide(tmp_path / "x.arrow", 60))
    for number in np.random.default_rng(1).integers(0, 60, 300):
        for name in (number, number + 1, number + 2):
            if name < 60:
                assert np.array_equal(found[f"c{name}"], np.full(8, name))
    assert {name: column[0] for name, column in found.several(["c7", "c3", "c7"]).items()} == {
        "c3": 3,
        "c7": 7,
    }
    with pytest.raises(KeyError):
        found.several(["c3", "d3"])


def test_reading_ahead_keeps_within_its_memory(tmp_path, monkeypatch):
    monkeypatch.setattr(stream, "_AHEAD", 10 * 8 * 8)  # ten columns of eight rows
    found = StreamedColumns(wide(tmp_path / "x.arrow", 200))
    most = 0
    for name in found:
        found[name]
        most = max(most, len(found._ahead))
    assert 0 < most < 10


# Memory.


def test_the_python_loop_keeps_no_rows(tmp_path):
    fmu = load_fmu(unruly_fmu(2, "m", "m"))
    system = assemble([Part("one", fmu, {"rate": "0.1 m"}), Part("two", fmu)], ["one.level -> two.rate"])

    def peak(steps: int) -> int:
        recorder = Recorder(system, path=tmp_path / "x.arrow")
        grid = Grid(Fraction(0), Fraction(1, 10**6), steps)
        tracemalloc.start()
        try:
            simulate(system, create_master("jacobi"), grid, [recorder], loop="python")
            recorder.close()
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    peak(3000)
    assert peak(12_000) < peak(3000) + 12_000  # bytes; a row has more than 24


LONG = """
import resource, sys
from fractions import Fraction
from pathlib import Path
from tests.assembled import assemble
from orchestrator.system.assembly import Part
from orchestrator.fmi import load_fmu
from orchestrator.master import create_master
from orchestrator.results.measures import signal_changes
from orchestrator.results.recorders import Recorder, read_results
from orchestrator.simulation.loop import Grid, simulate

fmu, folder, ends = load_fmu(Path(sys.argv[1])), Path(sys.argv[2]), map(int, sys.argv[3:])
system = assemble([Part("one", fmu, {"rate": "0.1 m"}), Part("two", fmu)], ["one.level -> two.rate"])
for steps in ends:
    paths = folder / f"{steps}.arrow", folder / f"{steps}-halved.arrow"
    for factor, path in enumerate(paths, 1):
        recorder = Recorder(system, path=path)
        grid = Grid(Fraction(0), Fraction(1, 1000 * factor), steps * factor)
        simulate(system, create_master("jacobi"), grid, [recorder], loop="native")
        recorder.close()
    changes = signal_changes(*map(read_results, paths))
    print(steps, changes["two.level"]["max_change"], resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads the peak memory as Linux tells it")
def test_memory_does_not_grow_with_the_steps(tmp_path):
    """In a process of its own, since the peak is that of a process's whole life [kB]."""
    command = [sys.executable, "-c", LONG, unruly_fmu(2, "m", "m"), tmp_path, "20000", "400000", "1600000"]
    done = subprocess.run(
        list(map(str, command)), capture_output=True, text=True, check=True, cwd=Path(__file__).parents[2]
    )
    (_, small_change, _), (_, _, short), (_, change, long) = (
        map(float, line.split()) for line in done.stdout.splitlines()
    )
    size = (tmp_path / "1600000-halved.arrow").stat().st_size / 1024
    assert change > small_change > 0.0
    assert long - short < size / 20
