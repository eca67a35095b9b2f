"""Small systems with effects on their connections, for tests of effects, masters and loops."""

from __future__ import annotations

from fractions import Fraction

import pytest
from assembled import assemble
from doubles import FakeFmu, gain, mass, spring

from orchestrator.effects.choose import BUILT_IN
from orchestrator.master import create_master
from orchestrator.results.recorders import Recorder
from orchestrator.simulation.grid import Grid
from orchestrator.simulation.loop import Report, simulate
from orchestrator.system.assembly import Part

# Each effect at zero size, and with an effect, on a signal in metres that is about one.
ZERO = {
    "gain": [{"gain": 1}, {"gain": 1.0}],
    "offset": [{"offset": "0 mm"}],
    "delay": [{"delay": "0 s"}, {"delay": "0 s", "before": "7 m"}],
    "low-pass": [{"low-pass": {"time_constant": "0 s"}}, {"low-pass": "inf Hz"}],
    "sample-and-hold": [{"sample-and-hold": "0 s", "phase": "1 ms"}],
    "saturate": [{"saturate": {}}, {"saturate": {"low": "-inf m", "high": "inf"}}],
    "quantise": [{"quantise": "0 m"}],
    "rate-limit": [{"rate-limit": "inf m/s"}],
    "dead-band": [{"dead-band": "0 m"}],
    "backlash": [{"backlash": "0 m"}],
    "noise": [
        {"noise": "0 m", "period": "1 ms", "seed": 5},
        {"noise": "0 m", "period": "1 ms", "seed": 5, "correlation": "1 ms"},
    ],
    "drift": [{"drift": "0 m/s"}],
    "dropout": [{"dropout": 0, "period": "1 ms", "seed": 5}],
    "jitter": [{"jitter": "0 s", "period": "1 ms", "seed": 5}],
    "map": [{"map": []}],
    "relay": [{"relay": "0 m"}, {"relay": "0 m", "width": "1 mm"}],
}
SIZED = {
    "gain": {"gain": 1.1},
    "offset": {"offset": "-10 cm"},
    "delay": {"delay": "33 ms"},
    "low-pass": {"low-pass": "20 Hz"},
    "sample-and-hold": {"sample-and-hold": "33 ms", "phase": "7 ms"},
    "saturate": {"saturate": {"high": "0.9 m"}},
    "quantise": {"quantise": "20 mm"},
    "rate-limit": {"rate-limit": "0.3 m/s"},
    "dead-band": {"dead-band": "0.1 m"},
    "backlash": {"backlash": "10 mm"},
    "noise": {"noise": "1 mm", "period": "7 ms", "seed": 5},
    "drift": {"drift": "-10 mm/s"},
    "dropout": {"dropout": 0.5, "period": "7 ms", "seed": 5},
    "jitter": {"jitter": "30 ms", "period": "7 ms", "seed": 5},
    "map": {"map": ["1 -> 3"]},
    "relay": {"relay": "1 m", "width": "1 mm"},
}
MASTERS = {
    "jacobi": {"name": "jacobi"},
    "jacobi-2": {"name": "jacobi", "extrapolation": 2},
    "gauss-seidel": {"name": "gauss-seidel"},
    "gauss-seidel-1": {"name": "gauss-seidel", "extrapolation": 1},
    "gauss-seidel-2": {"name": "gauss-seidel", "extrapolation": 2},
    "newton": {"name": "iterative", "tolerance": 1e-10},
    "newton-1": {"name": "iterative", "tolerance": 1e-10, "interpolation": 1},
    "anderson": {"name": "iterative", "tolerance": 1e-10, "method": "anderson"},
    "fixed-point": {"name": "iterative", "tolerance": 1e-10, "method": "fixed-point"},
    "doubling": {"name": "adaptive", "tolerance": 1e-4},
    "inputs": {"name": "adaptive", "tolerance": 1e-3, "estimate": "inputs"},
    "inputs-1": {
        "name": "adaptive",
        "tolerance": 1e-3,
        "estimate": "inputs",
        "base": {"name": "jacobi", "extrapolation": 1},
    },
    "iterative-parts": {
        "name": "adaptive",
        "tolerance": 1e-3,
        "base": {"name": "iterative", "tolerance": 1e-10},
    },
}
every_effect = pytest.mark.parametrize("name", BUILT_IN)
every_master = pytest.mark.parametrize("master", MASTERS.values(), ids=MASTERS.keys())


def simulated(system, master, steps, stop=1, loop="python"):
    recorder, report = Recorder(system), Report()
    chosen = create_master(master) if isinstance(master, str | dict) else master
    simulate(system, chosen, Grid(Fraction(0), Fraction(stop) / steps, steps), [recorder], report, loop=loop)
    assert report.loop == loop
    return recorder.results()


def bits(results):
    return results.time.tobytes(), {name: column.tobytes() for name, column in results.signals.items()}


def oscillator(through=(), **options):
    """X'' = -x, x(0) = 1 m: x = cos t; the spring gets the position through effects."""
    return assemble(
        [Part("mass", mass(), {"position": "1 m"}), Part("spring", spring())],
        [
            {"from": "mass.position", "to": "spring.position", "through": list(through)},
            "spring.force -> mass.force",
        ],
        **options,
    )


def ramp(function=lambda t: t, unit="m"):
    """An FMU that gives a function of time."""
    return FakeFmu(
        outputs={"y": unit},
        step=lambda values, time, h: values.update(now=time + h),
        output=lambda values: {"y": function(values.get("now", 0.0))},
    )


def filtered(through, function=lambda t: t, steps=100, master="gauss-seidel", unit="m", stop=1):
    """What comes out of effects on a function of time, at every point."""
    system = assemble(
        [Part("source", ramp(function, unit)), Part("sink", gain(1.0, unit, unit))],
        [{"from": "source.y", "to": "sink.u", "through": through}],
    )
    return simulated(system, master, steps, stop)["sink.y"]
