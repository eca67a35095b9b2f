"""Masters: one suite for all, against closed forms; what a step means; what goes wrong within one."""

from __future__ import annotations

import math
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from assembled import assemble
from doubles import FakeFmu, gain, mass, spring, variable

from orchestrator.base.errors import ConfigError, FmuError, StepError
from orchestrator.fmi import Causality, Initial, Kind, Point, StepStatus, Variability
from orchestrator.master import create_master, master_names
from orchestrator.master.running_instances import instantiate
from orchestrator.results.recorders import Recorder
from orchestrator.simulation.grid import Grid
from orchestrator.simulation.loop import Report, simulate
from orchestrator.system.assembly import Part

# With the options that the shared suite runs them with; loose ones make fixed steps of adaptive ones.
OPTIONS = {"iterative": {"tolerance": 1e-10}, "adaptive": {"tolerance": 1e9, "estimate": "inputs"}}

every_master = pytest.mark.parametrize("name", master_names())


def master(name: str, **options):
    return create_master({"name": name, **OPTIONS.get(name, {}), **options})


def simulated(system, name: str, steps: int, stop: int = 1):
    recorder = Recorder(system)
    simulate(system, master(name), Grid(Fraction(0), Fraction(stop, steps), steps), [recorder])
    return recorder.results()


def oscillator():
    """X'' = -x, x(0) = 1: x = cos t."""
    return assemble(
        [Part("mass", mass(), {"position": "1 m"}), Part("spring", spring())],
        ["mass.position -> spring.position", "spring.force -> mass.force"],
    )


def two_masses():
    """Two unit masses, each tied to a wall by a unit spring and to one another by a spring of stiffness 4.

    Modes: in phase at frequency 1, out of phase at 3; from x = (1, 0): x1 = (cos t + cos 3t)/2.
    """
    link = FakeFmu(
        name="Link",
        inputs={"one": "m", "other": "m"},
        outputs={"on_one": "N", "on_other": "N"},
        feedthrough={"on_one": ["one", "other"], "on_other": ["one", "other"]},
        output=lambda v: {
            "on_one": -v["one"] + 4.0 * (v["other"] - v["one"]),
            "on_other": -v["other"] + 4.0 * (v["one"] - v["other"]),
        },
    )
    return assemble(
        [Part("link", link), Part("a", mass(), {"position": "1 m"}), Part("b", mass())],
        [
            "a.position -> link.one",
            "b.position -> link.other",
            "link.on_one -> a.force",
            "link.on_other -> b.force",
        ],
    )


@every_master
@pytest.mark.parametrize(
    ("make", "signal", "exact"),
    [
        (oscillator, "mass.position", lambda t: np.cos(t)),
        (two_masses, "a.position", lambda t: (np.cos(t) + np.cos(3 * t)) / 2),
    ],
)
def test_converges_to_the_closed_form_with_the_masters_order(name, make, signal, exact):
    system, errors = make(), []
    for steps in (400, 800, 1600):
        results = simulated(system, name, steps)
        errors.append(np.abs(results[signal] - exact(results.time)).max())
    observed = [math.log2(coarse / fine) for coarse, fine in pairwise(errors)]
    assert observed == pytest.approx([master(name).order] * 2, abs=0.05)
    assert errors[-1] < 5e-3


def test_masters_agree_in_the_limit_and_differ_at_a_finite_step():
    system = oscillator()

    def apart(steps):
        ends = [simulated(system, name, steps)["mass.position"][-1] for name in ("jacobi", "gauss-seidel")]
        return abs(ends[0] - ends[1])

    assert apart(100) > 1e-3
    assert apart(1600) == pytest.approx(apart(100) / 16, rel=0.1)


@every_master
def test_values_of_a_row_belong_to_its_instant(name):
    clock = FakeFmu(
        outputs={"time": "s"},
        step=lambda values, time, h: values.update(now=time + h),
        output=lambda values: {"time": values.get("now", 0.0)},
    )
    results = simulated(assemble([Part("clock", clock)]), name, 10)
    assert results["clock.time"] == pytest.approx(results.time, abs=1e-15)
    assert results.time.tolist() == [n / 10 for n in range(11)]


def chain(length: int = 3):
    """A ramp through gains of one, connected in the reverse of the config's order."""
    ramp = FakeFmu(
        outputs={"y": ""},
        step=lambda values, time, h: values.update(now=time + h),
        output=lambda values: {"y": values.get("now", 0.0)},
    )
    parts = [Part(f"g{n}", gain()) for n in reversed(range(length))]
    return assemble(
        [*parts, Part("ramp", ramp)],
        ["ramp.y -> g0.u", *(f"g{n}.y -> g{n + 1}.u" for n in range(length - 1))],
    )


def test_jacobi_is_a_step_late_per_instance_and_gauss_seidel_is_not():
    jacobi, seidel = simulated(chain(), "jacobi", 10), simulated(chain(), "gauss-seidel", 10)
    for n in range(3):
        assert seidel[f"g{n}.y"].tolist() == seidel["ramp.y"].tolist()
        late = np.concatenate([np.zeros(n + 1), jacobi["ramp.y"]])[:11]
        assert jacobi[f"g{n}.y"].tolist() == late.tolist()


@every_master
def test_an_instance_gets_one_set_one_step_and_one_get_per_step(name):
    fmu = gain()
    calls = []

    class Watched:
        def __init__(self, inner):
            self.inner = inner

        def __getattr__(self, attribute):
            if attribute in ("write_inputs", "do_step", "read_outputs", "set_values", "get_values"):
                calls.append(attribute)
            return getattr(self.inner, attribute)

    original = fmu.instantiate
    fmu.instantiate = lambda name: Watched(original(name))
    system = assemble([Part("a", gain(), {"u": 1}), Part("b", fmu)], ["a.y -> b.u"])
    with instantiate(system) as instances:
        signals = instances.initialise(0.0, 1.0)
        calls.clear()
        master(name).step(system, instances, Point(0, 0.0, 0.1), signals)
    assert calls == ["write_inputs", "do_step", "read_outputs"]


@every_master
def test_a_step_returns_new_signals_and_leaves_the_old_ones_alone(name):
    system = oscillator()
    with instantiate(system) as instances:
        before = instances.initialise(0.0, 1.0)
        kept = before.values.copy()
        after, info = master(name).step(system, instances, Point(0, 0.0, 0.5), before)
        info.raise_on_failure(Point(0, 0.0, 0.5))
        assert before.values.tolist() == kept.tolist() == [1.0, 0.0, -1.0]
        # Implicit: the force of the end, x = 1 - h*h/2 * x.
        end = 1.0 / 1.125 if name == "iterative" else 1.0 - 0.125
        assert after.values is not before.values and after.values[0] == pytest.approx(end, rel=1e-12)


@every_master
def test_conversion_on_a_connection_and_integers_booleans_and_texts(name):
    def port(label, causality, kind, **more):
        return variable(
            label, causality, kind=kind, type={"Real": "Float64", "Integer": "Int32"}.get(kind, kind),
            variability=Variability.DISCRETE, **more,
        )  # fmt: skip

    def outputs(values):
        return {"count": values["n"], "odd": values["n"] % 2, "word": f"step {int(values['n'])}"}

    source = FakeFmu(
        extra=[
            port("n", Causality.LOCAL, Kind.INTEGER, start=0),
            port("count", Causality.OUTPUT, Kind.INTEGER, initial=Initial.CALCULATED),
            port("odd", Causality.OUTPUT, Kind.BOOLEAN, initial=Initial.CALCULATED),
            port("word", Causality.OUTPUT, Kind.STRING, initial=Initial.CALCULATED),
        ],
        step=lambda values, time, h: values.update(n=values["n"] + 1),
        output=outputs,
    )
    target = FakeFmu(
        inputs={"length": "m"},
        outputs={"seen": "m"},
        feedthrough={"seen": ["length"]},
        extra=[
            port("count", Causality.INPUT, Kind.INTEGER),
            port("odd", Causality.INPUT, Kind.BOOLEAN),
            port("word", Causality.INPUT, Kind.STRING),
            port("length_of_word", Causality.OUTPUT, Kind.INTEGER, initial=Initial.CALCULATED),
        ],
        output=lambda v: {"seen": v["length"], "length_of_word": len(str(v["word"])) * int(v["count"])},
    )
    rod = FakeFmu(outputs={"y": "mm"}, output=lambda values: {"y": 250.0})
    system = assemble(
        [Part("source", source), Part("target", target), Part("rod", rod)],
        ["rod.y -> target.length", *(f"source.{n} -> target.{n}" for n in ("count", "odd", "word"))],
    )
    results = simulated(system, name, 4)
    assert results["source.count"].tolist() == [0, 1, 2, 3, 4] and results["source.count"].dtype == np.int64
    assert results["source.odd"].tolist() == [False, True, False, True, False]
    assert results["target.seen"].tolist() == [0.25] * 5
    late = 1 if name == "jacobi" else 0
    assert results["target.length_of_word"][-1] == (4 - late) * len("step 4")


# Initialisation.


def test_initial_outputs_pass_in_feedthrough_order_before_the_first_step():
    inner = spring(2.0)
    outer = gain(10.0, "N", "N")
    system = assemble(
        [Part("outer", outer), Part("spring", inner), Part("mass", mass(), {"position": "3 m"})],
        ["mass.position -> spring.position", "spring.force -> outer.u", "outer.y -> mass.force"],
    )
    results = simulated(system, "jacobi", 1)
    assert [results[name][0] for name in ("mass.position", "spring.force", "outer.y")] == [3.0, -6.0, -60.0]
    assert inner.calls[:3] == [
        ("spring", "set position"),
        ("spring", "get force"),
        ("spring", "exit_initialisation"),
    ]


# Failures.


def failing(at: float, **outcome):
    """An integrator that misbehaves from a time on: nan=..., status=..., error=..."""

    def step(values, time, h):
        values["level"] += h
        if time >= at - 1e-12:
            if "value" in outcome:
                values["level"] = outcome["value"]
            if "error" in outcome:
                raise StepError(
                    outcome["error"], instance="bad", time=time, status="error", log=["[error] dry"]
                )
            return outcome.get("status")
        return None

    level = variable("level", Causality.OUTPUT, "m", initial=Initial.EXACT)
    return FakeFmu(name="Failing", inputs={"u": "m"}, extra=[level], step=step)


def failure(name, bad, *others):
    """The error of a run, what was recorded, and which instances were not freed."""
    system = assemble([Part("bad", bad, {"u": "0 m"}), *others[:1]], others[1:])
    recorder = Recorder(system)
    with pytest.raises(StepError) as caught:
        simulate(system, master(name), Grid(Fraction(0), Fraction(1, 10), 10), [recorder])
    assert [one for part in system.instances for one in part.fmu.alive] == []
    return caught.value, recorder.results()


@every_master
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_value_that_is_not_finite_stops_the_run_by_name(name, value):
    error, results = failure(name, failing(0.5, value=value))
    assert str(error) == (
        f"bad at time 0.6 s: level [m] is {value!r}\n"
        "  Check the values that it is given, or take a smaller step size."
    )
    assert (error.instance, error.status) == ("bad", "not finite")
    assert results.time[-1] == 0.5 and np.isfinite(results["bad.level"]).all()


@every_master
def test_who_fails_on_a_nan_that_it_was_given_is_not_blamed(name):
    def choke(values, time, h):
        if not math.isfinite(values["u"]):
            raise StepError("fmi2DoStep returned error", instance="victim", time=time, status="error")

    victim = FakeFmu(inputs={"u": "m"}, outputs={"y": "m"}, step=choke)
    error, _ = failure(name, failing(0.5, value=math.nan), Part("victim", victim), "bad.level -> victim.u")
    assert error.instance == "bad" and "level [m] is nan" in str(error)


@every_master
def test_an_error_within_a_step_keeps_what_was_recorded(name):
    error, results = failure(name, failing(0.5, error="fmi2DoStep returned error"))
    assert str(error) == ("bad at time 0.5 s: fmi2DoStep returned error\n  log of the FMU:\n    [error] dry")
    assert results.time.tolist() == [n / 10 for n in range(6)]


@every_master
def test_a_step_that_is_not_finished_ends_the_run(name):
    error, results = failure(name, failing(0.5, status=StepStatus.DISCARD))
    assert str(error) == "bad at time 0.5 s: refused a step of 0.1 s\n  Take a smaller step size."
    assert error.status == "discard" and results.time[-1] == 0.5


def test_the_other_instances_are_terminated_and_all_are_freed():
    good = gain()
    failure("jacobi", failing(0.5, error="x"), Part("good", good), "bad.level -> good.u")
    assert ("good", "terminate") in good.calls


def test_instances_that_were_never_started_are_freed_but_not_terminated():
    class Unloadable(FakeFmu):
        def instantiate(self, name):
            raise FmuError("x.fmu: its library cannot be loaded")

    good = mass()
    system = assemble([Part("good", good, {"force": "0 N"}), Part("bad", Unloadable())])
    with pytest.raises(FmuError):
        simulate(system, create_master("jacobi"), Grid(Fraction(0), Fraction(1), 1))
    assert good.calls == [] and good.alive == []


def test_a_report_tells_time_and_warnings_also_of_a_failed_run():
    good = mass()
    original = good.instantiate

    def talkative(name):
        instance = original(name)
        instance.log += ["[ok] hello", "[warning] hot"]
        return instance

    good.instantiate = talkative
    system = assemble(
        [Part("bad", failing(0.5, error="x"), {"u": "0 m"}), Part("good", good, {"force": "0 N"})]
    )
    report = Report()
    with pytest.raises(StepError):
        simulate(system, create_master("jacobi"), Grid(Fraction(0), Fraction(1, 10), 10), [], report)
    assert report.log == {"good": ["[warning] hot"]}
    assert set(report.instance_time) == {"bad", "good"} and report.instance_time["good"] > 0.0


def test_unknown_master():
    with pytest.raises(ConfigError) as caught:
        create_master("gauss_seidel", "docking.yaml:2: run.master")
    assert str(caught.value) == (
        "docking.yaml:2: run.master: no master 'gauss_seidel'\n"
        "  masters: jacobi, gauss-seidel, iterative, adaptive. Did you mean gauss-seidel?"
    )
