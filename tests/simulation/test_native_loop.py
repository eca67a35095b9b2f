"""The native loop against the interpreter's: the same bits, the same errors, whatever happens in a run."""

from __future__ import annotations

import ctypes
import math
import os
import signal
import subprocess
import sys
import threading
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import yaml
from assembled import assemble
from doubles import mass
from unruly import WAYS, unruly_fmu

from orchestrator.base.errors import ConfigError, StepError
from orchestrator.fmi import load_fmu
from orchestrator.master import create_master
from orchestrator.master.jacobi import Jacobi
from orchestrator.master.running_instances import instantiate
from orchestrator.results.recorders import Recorder
from orchestrator.simulation.grid import Grid
from orchestrator.simulation.loop import Report, simulate
from orchestrator.simulation.native import choice
from orchestrator.simulation.native.choice import schedule
from orchestrator.simulation.native.tables import Tables
from orchestrator.simulation.run import prepare, run
from orchestrator.system.assembly import Part

pytest.importorskip("numba")
# The docking FMUs bring a pythonfmu of their own, without what building takes: find the installed one first.
pytest.importorskip("pythonfmu")

MASTERS = ("jacobi", "gauss-seidel")
every_master = pytest.mark.parametrize("master", MASTERS)
CURVED = [f"{{name: {name}, extrapolation: {order}}}" for name in MASTERS for order in (1, 2)]
curved_or_not = pytest.mark.parametrize("master", [*MASTERS, *CURVED])
every_version = pytest.mark.parametrize("version", [2, 3])


def ring(version: int, units: tuple[str, str] = ("mm", "m"), **of_second):
    """Three integrators in a chain, with unit conversions that round between; `of_second`: start values."""
    fmu = load_fmu(unruly_fmu(version, *units))
    return assemble(
        [Part("one", fmu), Part("two", fmu, of_second), Part("three", fmu, {"rate": f"0.1 {units[0]}"})],
        ["three.level -> one.rate", "one.level -> two.rate"],
    )


class Kept:
    """What a run showed: times, values to the bit, error, log."""

    def __init__(self, system, master: str, steps: int, loop: str, step=Fraction(1, 700)) -> None:
        self.recorder, self.report, self.error = Recorder(system), Report(), None
        try:
            grid = Grid(Fraction(1, 3), step, steps)
            made = create_master(yaml.safe_load(master))
            simulate(system, made, grid, [self.recorder], self.report, loop=loop)
        except StepError as error:
            self.error = (str(error), error.instance, error.time, error.status, error.log)
        self.results = self.recorder.results()
        values = {name: column.tobytes() for name, column in self.results.signals.items()}
        ended = self.report.ended
        self.ended = ended and (ended.instance, ended.time)
        self.seen = (self.results.time.tobytes(), values, self.error, self.ended, self.report.log)


def both(system, master: str, steps: int = 2500, **options) -> Kept:
    """The native run, after it has been compared with the interpreter's."""
    native = Kept(system, master, steps, "native", **options)
    python = Kept(system, master, steps, "python", **options)
    assert (native.report.loop, python.report.loop) == ("native", "python")
    assert native.seen == python.seen
    return native


@curved_or_not
@every_version
@pytest.mark.parametrize("units", [("mm", "m"), ("m", "m"), ("K", "degC")])
def test_bits_are_the_same_across_chunks_units_and_types(master, version, units):
    kept = both(ring(version, units), master)
    assert kept.error is None and len(kept.results) == 2501
    level = kept.results["two.level"]
    assert len(np.unique(level)) > 2400 and kept.results["one.count"][-1] == 2500


@curved_or_not
@every_version
@pytest.mark.parametrize("steps_before", [0, 1, 1300])
@pytest.mark.parametrize("way", WAYS[2:8])
def test_failures_are_the_same(way, steps_before, master, version):
    at = float(Fraction(1, 3) + steps_before * Fraction(1, 700))
    kept = both(ring(version, way=WAYS.index(way), at=at), master)
    assert (kept.error or (None, *(kept.ended or ("",))))[1] == "two"
    assert steps_before < len(kept.results) <= steps_before + 2


@every_master
@every_version
@pytest.mark.parametrize("ratios", [(3, 1, 1), (1, 7, Fraction(1, 4)), (Fraction(1, 3), 2, 5)])
@pytest.mark.parametrize("effect", [None, "delay"])
def test_bits_are_the_same_with_steps_of_their_own(ratios, master, version, effect):
    """Slow ones keep their outputs until their steps end, which chunks do not divide; fast ones repeat."""
    fmu = load_fmu(unruly_fmu(version))
    starts = ({}, {}, {"rate": "0.1 mm"})
    parts = [
        Part(name, fmu, start, ratio=Fraction(ratio))
        for name, start, ratio in zip(("one", "two", "three"), starts, ratios, strict=True)
    ]
    links = ["three.level -> one.rate", "one.level -> two.rate"]
    if effect:
        links[1] = {"from": "one.level", "to": "two.rate", "through": [{"effect": effect, "time": "5 ms"}]}
    kept = both(assemble(parts, links), master, 2100)
    assert kept.error is None and len(np.unique(kept.results["two.level"])) > 2000 / max(ratios)


@every_master
@every_version
@pytest.mark.parametrize("ratio", [3, Fraction(1, 4)])
@pytest.mark.parametrize("steps_before", [0, 1, 1300])
@pytest.mark.parametrize("way", WAYS[2:8])
def test_failures_in_steps_of_their_own_are_the_same(way, steps_before, ratio, master, version):
    at = float(Fraction(1, 3) + (steps_before + Fraction(1, 2)) * Fraction(1, 700))
    fmu = load_fmu(unruly_fmu(version))
    sick = Part("two", fmu, {"way": WAYS.index(way), "at": at}, ratio=Fraction(ratio))
    parts = [Part("one", fmu), sick, Part("three", fmu, {"rate": "0.1 mm"})]
    kept = both(assemble(parts, ["three.level -> one.rate", "one.level -> two.rate"]), master, 1500)
    assert (kept.error or (None, *(kept.ended or ("",))))[1] == "two"


@every_master
@pytest.mark.parametrize("steps_before", [None, 0, 1, 1300, 1344])
@pytest.mark.parametrize("way", WAYS[2:8])
def test_plain_systems_take_the_short_way_to_the_same(way, steps_before, master):
    """Doubles only: what is not recorded and not connected is not read."""
    never = steps_before is None
    at = 1e9 if never else float(Fraction(1, 3) + steps_before * Fraction(1, 700))
    fmu = load_fmu(unruly_fmu(2, "m", "m"))
    sick = Part("two", fmu, {"way": WAYS.index(way), "at": at})
    parts = [Part("one", fmu), sick, Part("three", fmu, {"rate": "0.1 m"})]
    links = ["three.level -> one.rate", "one.level -> two.rate"]
    system = assemble(parts, links, record=["one.level", "two.level", "three.level"])
    with instantiate(system) as instances:
        instances.initialise(0.0, 1.0)
        native = [one.native_calls() for one in instances.running]
        assert len(Tables.of(instances, native, schedule(instances, create_master(master)), 0.1).plan) == 3
    kept = both(system, master)
    assert not never or len(np.unique(kept.results["two.level"])) > 2400
    assert kept.error is None if never else (kept.error or (None, *kept.ended))[1] == "two"
    assert never or steps_before < len(kept.results) <= steps_before + 2


def ending(version: int, who: str, at: float, units=("m", "m"), own=1, through=()):
    """Three integrators in a chain, of which one ends the simulation after the step from a time."""
    fmu = load_fmu(unruly_fmu(version, *units))
    starts = {"one": {}, "two": {}, "three": {"rate": f"0.1 {units[0]}"}}
    starts[who] |= {"way": WAYS.index("ends"), "at": at}
    parts = [
        Part(name, fmu, start, ratio=Fraction(own if name == who else 1)) for name, start in starts.items()
    ]
    return assemble(
        parts,
        ["three.level -> one.rate", {"from": "one.level", "to": "two.rate", "through": list(through)}],
    )


@curved_or_not
@every_version
@pytest.mark.parametrize("through", [(), ({"effect": "delay", "time": "5 ms"},)])
@pytest.mark.parametrize("who", ["one", "two", "three"])
@pytest.mark.parametrize("steps_before", [0, 1, 1300])
def test_an_fmu_that_ends_the_simulation_after_a_step_has_all_finish_it(
    steps_before, who, through, master, version
):
    system = ending(
        version, who, float(Fraction(1, 3) + steps_before * Fraction(1, 700)), ("mm", "m"), 1, through
    )
    kept = both(system, master, 2000)
    assert kept.error is None and kept.ended == (who, kept.results.time[-1])
    assert len(kept.results) == steps_before + 2
    assert all(kept.results[f"{name}.count"][-1] == steps_before + 1 for name in ("one", "two", "three"))


@every_master
@every_version
@pytest.mark.parametrize("steps_before", [0, 1300])
def test_a_slow_instance_ends_the_simulation_after_its_own_step(steps_before, master, version):
    at = float(Fraction(1, 3) + steps_before * Fraction(1, 700))
    kept = both(ending(version, "two", at, own=4), master, 2000)
    assert kept.error is None and kept.ended == ("two", kept.results.time[-1])
    assert len(kept.results) == steps_before + 5


@curved_or_not
@every_version
@pytest.mark.parametrize("steps_before", [0, 1300])
@pytest.mark.parametrize("part", [0, 2])
def test_a_fast_instance_ends_the_simulation_after_the_last_part_of_a_step(
    part, steps_before, master, version
):
    """After another part it ends before the communication point: the last point is the one before."""
    at = float(Fraction(1, 3) + (steps_before + Fraction(part, 3)) * Fraction(1, 700))
    kept = both(ending(version, "two", at, own=Fraction(1, 3)), master, 2000)
    assert kept.error is None and kept.ended[0] == "two"
    assert len(kept.results) == steps_before + (2 if part == 2 else 1)


@every_master
@pytest.mark.parametrize("steps_before", [0, 1, 62, 63, 64, 1300, 2498])
def test_plain_systems_end_after_a_step_as_well(steps_before, master):
    fmu = load_fmu(unruly_fmu(2))
    at = float(Fraction(1, 3) + steps_before * Fraction(1, 700))
    parts = [Part("one", fmu, {"rate": "1 m"}), Part("two", fmu, {"way": WAYS.index("ends"), "at": at})]
    system = assemble(parts, ["one.level -> two.rate"], record=["one.level", "two.level"])
    kept = both(system, master)
    assert kept.error is None and kept.ended == ("two", kept.results.time[-1])
    assert len(kept.results) == steps_before + 2


@curved_or_not
@every_version
def test_warnings_are_logged_and_the_run_goes_on(master, version):
    kept = both(ring(version, way=WAYS.index("warn"), at=2.0), master)
    assert kept.error is None
    assert kept.report.log["two"][-1].endswith("goes on with a warning")


@every_version
def test_an_fmu_that_fails_on_what_it_was_given_is_not_blamed(version):
    fmu = load_fmu(unruly_fmu(version))
    parts = [
        Part("sick", fmu, {"rate": "1 m", "way": WAYS.index("nan level"), "at": 2.0}),
        Part("victim", fmu, {"way": WAYS.index("complains")}),
    ]
    kept = both(assemble(parts, ["sick.level -> victim.rate"]), "gauss-seidel")
    assert kept.error[1] == "sick" and kept.error[3] == "not finite"


def test_every_type_is_converted_as_ctypes_does(c_fmu):
    fmu = load_fmu(c_fmu)
    connected = [
        ("single_out", "single_in"),
        ("byte_out", "byte_in"),
        ("count_out", "count_in"),
        ("level_out", "level_in"),
        ("flag_out", "flag_in"),
    ]
    start = {
        "real_in": "1.7 m/s", "single_in": "0.1 rad/s", "byte_in": 3, "count_in": 2**32 - 3, "level_in": 2,
        "flag_in": True, "word_in": "none", "limit": "1e9 mm",
    }  # fmt: skip
    fed = {target for _, target in connected}
    unfed = {name: value for name, value in start.items() if name not in fed}
    parts = [Part("a", fmu, start), Part("b", fmu, unfed)]
    system = assemble(parts, [f"a.{source} -> b.{target}" for source, target in connected])
    kept = both(system, "gauss-seidel", 40)
    assert kept.error is None
    assert kept.results["b.byte_out"][-1] == 3
    assert kept.results["b.count_out"][-1] == 2**32 - 1


OTHERS = {
    "real_in": "0 m/s",
    "single_in": "0 rad/s",
    "count_in": 0,
    "level_in": 2,
    "flag_in": True,
    "word_in": "-",
}


@every_master
@pytest.mark.parametrize("version", [2, 3])
def test_a_whole_number_beyond_the_inputs_type_fails_the_same(master, version, c_fmu):
    """A count of steps that comes to 128, in a byte with a sign; ctypes would make -128 of it."""
    parts = [Part("one", load_fmu(unruly_fmu(version)), {"rate": "0 m"}), Part("b", load_fmu(c_fmu), OTHERS)]
    kept = both(assemble(parts, ["one.count -> b.byte_in"]), master, 200)
    assert kept.error[1] == "b" and kept.error[3] == "out of range"
    step = 126 if master == "gauss-seidel" else 127
    assert kept.error[0] == (
        f"b at time {1 / 3 + step / 700:.12g} s: byte_in (Int8) cannot hold 128; it holds whole numbers "
        "from -128 to 127\n  Give it a value within, or scale what feeds it."
    )
    assert max(kept.results["b.byte_out"]) <= 0


def test_whole_numbers_are_sent_where_their_type_holds_them():
    from numba import njit

    from orchestrator.simulation.native.kernel import _fetch, _send
    from orchestrator.simulation.native.table_columns import Call, Code
    from orchestrator.simulation.native.tables import _CODES

    send, fetch = njit(_send), njit(_fetch)
    values = [0.5, 1.5, -2.5, 1e10, -1e10, -(2.0**70) - 2.0**30, 1e300, 255.49, 0.3, -0.3, np.nan, -np.inf]
    values += [sign * 2.0**bits + more for bits in (7, 8, 15, 16, 31, 32, 63, 64) for sign in (-1, 1)
               for more in (-1, -0.6, 0, 0.4)]  # fmt: skip
    for ctype, code in _CODES.items():
        if code in (Code.F64, Code.F32):
            continue
        held = [value for value in values if math.isfinite(value)]
        largest = {Code.I64: 2**63 - 1, Code.U64: 2**64 - 1}.get(code, 0)

        def stored(value, ctype=ctype, largest=largest):
            # The double next to the largest number of 64 bits is one beyond it.
            return largest if largest and value == float(largest) else ctype(round(value)).value

        if code != Code.BOOL:
            held = [value for value in held if float(stored(value)) == round(value)]
        assert 4 < len(held) < len(values)
        places = np.arange(len(held))
        buffer, memory = (ctype * len(held))(), np.array(held)
        row = np.zeros((1, len(Call)), np.int64)
        row[0, Call.VALUES], row[0, Call.CODE] = ctypes.addressof(buffer), code
        row[0, Call.VALUE_COUNT] = len(held)
        assert send(row.ctypes.data, places.ctypes.data, memory.ctypes.data)
        assert list(buffer) == [stored(value) for value in held], ctype
        backwards = places[::-1].copy()
        fetch(row.ctypes.data, backwards.ctypes.data, memory.ctypes.data)
        assert memory[::-1].tolist() == [float(value) for value in buffer], ctype
        for value in set(values) - set(held):
            memory[-1] = value
            assert not send(row.ctypes.data, places.ctypes.data, memory.ctypes.data), (ctype, value)
            memory[-1] = held[0]


@pytest.mark.parametrize("name", ["docking-1d", "docking-1d-uncompensated"])
@curved_or_not
def test_docking_gives_the_same_bits(name, master):
    def ran(loop):
        changes = [f"run.loop={loop}", f"run.master={master}", "run.stop_time=0.4 s"]
        changes += ["bonds=[]"] if master in CURVED else []
        result = run(name, overrides=changes, halving=False)
        assert result.summary["run"]["loop"] == loop
        return result.results.time.tobytes(), {k: v.tobytes() for k, v in result.results.signals.items()}

    assert ran("native") == ran("python")


def test_python_fmus_run_in_it_and_other_threads_go_on(python_fmu):
    fmu = load_fmu(python_fmu("misbehaving"))
    system = assemble(
        [Part("one", fmu, {"rate": 0.1}), Part("two", fmu, {"way": "error", "at": 2.0})],
        ["one.level -> two.rate"],
    )
    turns, done = [], threading.Event()

    def spin() -> None:
        while not done.is_set():
            turns.append(1)
            done.wait(1e-4)

    thread = threading.Thread(target=spin)
    thread.start()
    kept = both(system, "jacobi", 2000)
    done.set()
    thread.join()
    assert kept.error[1:4] == ("two", pytest.approx(2.0, abs=2e-3), "fatal") and turns
    assert any("the tank is empty" in line for line in kept.error[4])


def test_recording_every_nth_point_some_signals_and_a_stream(tmp_path):
    fmu = load_fmu(unruly_fmu(3))
    system = assemble(
        [Part("one", fmu, {"rate": "1 m"}), Part("two", fmu)],
        ["one.level -> two.rate"],
        record=["two.level", "one.count"],
    )
    texts = []
    for loop in ("native", "python"):
        path = tmp_path / f"{loop}.arrow"
        recorder = Recorder(system, every=7, path=path)
        grid = Grid(Fraction(0), Fraction(1, 700), 2500)
        simulate(system, create_master("jacobi"), grid, [recorder], loop=loop)
        recorder.close()
        results = recorder.results()
        results.to_csv(tmp_path / "results.csv")
        texts.append((tmp_path / "results.csv").read_text())
        assert len(results) == 358 and results["one.count"][-1] == 2499
    assert texts[0] == texts[1]


def test_observers_that_take_points_see_them_in_turn_until_one_raises():
    system, grid = ring(3), Grid(Fraction(0), Fraction(1, 10), 5000)
    for loop in ("native", "python"):
        seen = []

        def stop_at(point, signals):
            if point.index == 1200:
                raise RuntimeError("enough")

        recorder = Recorder(system)
        observers = [recorder, lambda point, signals, seen=seen: seen.append((point, signals)), stop_at]
        with pytest.raises(RuntimeError, match="enough"):
            simulate(system, Jacobi(), grid, observers, loop=loop)
        assert [point.index for point, _ in seen] == list(range(1201)) and len(recorder.results()) == 1201
        levels = [signals.values[0] for _, signals in seen]
        assert np.array_equal(levels, recorder.results()["one.level"])


def test_points_are_the_grids():
    for loop in ("native", "python"):
        points = []
        grid = Grid(Fraction(-1, 3), Fraction(1, 10**15), 40)
        simulate(ring(2), Jacobi(), grid, [lambda point, _, to=points: to.append(point)], loop=loop)
        assert points == list(grid)


@pytest.mark.parametrize("denominator", [3, 700, 10**6, 10**15, 3**40])
def test_times_of_a_stretch_are_rounded_once(denominator):
    grid = Grid(Fraction(-5, 7), Fraction(1, denominator), 3000)
    assert grid.times(0, 3001).tolist() == [point.time for point in grid]
    assert grid.times(17, 18).tolist() == [float(grid.start + 17 * grid.step_size)]


def test_an_interrupt_ends_it_between_chunks_and_keeps_what_was_seen():
    system, recorder = ring(2), Recorder(ring(2))

    def interrupt(point, signals):
        if point.index == 500:
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        simulate(
            system,
            create_master("jacobi"),
            Grid(Fraction(0), Fraction(1, 700), 10**6),
            [recorder, interrupt],
            loop="native",
        )
    kept = recorder.results()
    assert 501 <= len(kept) < 5000
    whole = Recorder(system)
    grid = Grid(Fraction(0), Fraction(1, 700), len(kept) - 1)
    simulate(system, create_master("jacobi"), grid, [whole], loop="python")
    assert kept["two.level"].tobytes() == whole.results()["two.level"].tobytes()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_time_is_divided_among_the_instances(python_fmu):
    slow = load_fmu(python_fmu("misbehaving"))
    fast = load_fmu(unruly_fmu(2))
    system = assemble([Part("slow", slow, {"rate": 0.1}), Part("fast", fast, {"rate": "1 m"})])
    kept = Kept(system, "jacobi", 2000, "native")
    times = kept.report.instance_time
    assert times["slow"] > 5 * times["fast"] > 0


class _Other(Jacobi):
    pass


def test_what_it_cannot_run_is_refused_or_left_to_python():
    system = assemble([Part("mass", mass(), {"force": "0 N"})])
    grid, report = Grid(Fraction(0), Fraction(1, 10**6), 10), Report()
    with pytest.raises(ConfigError) as caught:
        simulate(system, Jacobi(), grid, loop="native")
    assert str(caught.value).splitlines() == [
        "run.loop: the native loop cannot run this: instance mass is stepped by Python code",
        "  Use loop: auto.",
    ]
    with pytest.raises(ConfigError, match="the master _Other works in Python"):
        simulate(ring(2), _Other(), grid, loop="native")
    simulate(system, Jacobi(), grid, report=report)
    assert report.loop == "python"


def test_strings_are_left_to_python(c_fmu):
    fmu = load_fmu(c_fmu)
    start = {"real_in": "1 m/s", "single_in": "1 rad/s", "byte_in": 1, "count_in": 1, "level_in": 1}
    start["flag_in"] = True
    parts = [Part("a", fmu, {**start, "word_in": "x"}), Part("b", fmu, start)]
    system = assemble(parts, ["a.word_out -> b.word_in"])
    with pytest.raises(ConfigError, match="strings of instance a are connected"):
        simulate(system, Jacobi(), Grid(Fraction(0), Fraction(1, 8), 10), loop="native")


def test_auto_weighs_what_is_saved_against_the_start(monkeypatch):
    chosen = []
    for start in (1e-9, 1e9):
        monkeypatch.setattr(choice, "_start_up", lambda kernel, saved, start=start: start)
        report = Report()
        simulate(ring(2), Jacobi(), Grid(Fraction(0), Fraction(1, 10), 1000), report=report)
        chosen.append(report.loop)
    assert chosen == ["native", "python"]


def test_without_numba_everything_runs_in_python(monkeypatch):
    monkeypatch.setattr(choice, "find_spec", lambda name: None)
    monkeypatch.setattr(choice, "_start_up", lambda kernel, saved: 0.0)
    report = Report()
    simulate(ring(2), Jacobi(), Grid(Fraction(0), Fraction(1, 10), 10), report=report)
    assert report.loop == "python"
    with pytest.raises(ConfigError, match="the package numba is not installed"):
        simulate(ring(2), Jacobi(), Grid(Fraction(0), Fraction(1, 10), 10), loop="native")


def test_the_choice_finds_what_is_kept():
    from orchestrator.base.compiled_functions import digest, is_kept
    from orchestrator.simulation.native import kernel

    simulate(ring(2), Jacobi(), Grid(Fraction(0), Fraction(1, 10), 10), loop="native")
    source = Path(kernel.__file__)
    if Path(kernel.run_steps.stats.cache_path) != source.parent / "__pycache__":
        pytest.skip("machine code is kept elsewhere")
    assert is_kept(source, "run_steps") == bool(digest())
    assert not is_kept(source, "run_step")


def test_a_loop_that_there_is_not_is_refused():
    with pytest.raises(ConfigError) as caught:
        prepare("docking-1d", ["run.loop=fast"])
    assert "--set run.loop=fast: run.loop: input should be 'auto', 'python' or 'native', got 'fast'" in str(
        caught.value
    )


def test_numba_is_imported_for_long_runs_only():
    code = (
        "import sys; from orchestrator.simulation.run import run;"
        "r = run('docking-1d', overrides=['run.stop_time=1 ms'], halving=False);"
        "assert r.summary['run']['loop'] == 'python' and 'numba' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path(__file__).parents[2])


# What two processes keep on disk is one process's, later: three.level through noise, under each master given.
_THROUGH_NOISE = """
import sys
here, tests, root, *masters = sys.argv[1:]
sys.path[:0] = [here, tests, root]
from test_native_loop import Fraction, Kept, Part, assemble, load_fmu, unruly_fmu
for master in masters:
    fmu = load_fmu(unruly_fmu(2))
    parts = [Part("one", fmu), Part("three", fmu, {"rate": "0.1 mm"})]
    noise = {"effect": "noise", "deviation": "1 mm", "period": "3 ms", "seed": 4}
    links = [{"from": "three.level", "to": "one.rate", "through": [noise]} if "plain" not in master else
             "three.level -> one.rate"]
    kept = Kept(assemble(parts, links), master.removeprefix("plain "), 200, "native")
    print(kept.error, kept.results["one.level"][-1])
"""


def test_machine_code_of_several_processes_serves_one(tmp_path):
    here = Path(__file__).parent
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}

    def ran(*masters: str) -> list[str]:
        folders = map(str, (here, here.parent, here.parents[1]))
        command = [sys.executable, "-c", _THROUGH_NOISE, *folders, *masters]
        return subprocess.run(
            command, env=environment, capture_output=True, text=True, check=True
        ).stdout.splitlines()

    curved = CURVED[0]
    first = [*ran("plain jacobi", curved)[1:], *ran("jacobi")]
    assert ran("jacobi", curved) == first[::-1]
    assert all(line.startswith("None ") for line in first)
