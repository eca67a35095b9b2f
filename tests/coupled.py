"""Masses and springs coupled by bonds, whose energy is known, for tests of the ledger and its bonds."""

from __future__ import annotations

from fractions import Fraction

import pytest
from assembled import assemble
from doubles import FakeFmu, mass, variable

from orchestrator.fmi import Causality, Initial
from orchestrator.master import create_master
from orchestrator.master.energy import Ledger
from orchestrator.results.recorders import Recorder
from orchestrator.simulation.grid import Grid
from orchestrator.simulation.loop import simulate
from orchestrator.system.assembly import Part

MASTERS = [
    "jacobi",
    "gauss-seidel",
    {"name": "jacobi", "extrapolation": 1},
    {"name": "gauss-seidel", "extrapolation": 2},
    {"name": "iterative", "tolerance": 1e-12},
    {"name": "iterative", "tolerance": 1e-12, "interpolation": 1},
    {"name": "adaptive", "tolerance": 1e-3},
    {"name": "adaptive", "tolerance": 1e-1, "estimate": "inputs"},
]
PERIOD = Fraction(44, 7)  # of x'' = -x, nearly
every_master = pytest.mark.parametrize("name", MASTERS, ids=str)


def link():
    """Springs from wall to a to b to wall; forces and energy follow from the positions that it is given."""
    return FakeFmu(
        name="Link",
        inputs={"one": "m", "other": "m"},
        outputs={"on_one": "N", "on_other": "N", "energy": ""},
        feedthrough={name: ["one", "other"] for name in ("on_one", "on_other", "energy")},
        output=lambda v: {
            "on_one": -v["one"] + 4.0 * (v["other"] - v["one"]),
            "on_other": -v["other"] + 4.0 * (v["one"] - v["other"]),
            "energy": (v["one"] ** 2 + v["other"] ** 2) / 2 + 2.0 * (v["other"] - v["one"]) ** 2,
        },
    )


def moved_spring(stiffness=1.0):
    """A spring that is reported a velocity, which it integrates; its energy is its own affair."""

    def step(values, time, h):
        values["stretch"] += h * values["velocity"]

    return FakeFmu(
        name="Spring",
        inputs={"velocity": "m/s"},
        outputs={"force": "N", "energy": ""},
        extra=[variable("stretch", Causality.OUTPUT, initial=Initial.EXACT)],
        output=lambda v: {
            "force": -stiffness * v["stretch"],
            "energy": stiffness * v["stretch"] ** 2 / 2,
        },
        step=step,
    )


def two_masses(**ratios):
    return assemble(
        [
            Part("link", link(), ratio=ratios.get("link", Fraction(1))),
            Part("a", mass(), {"position": "1 m"}, ratio=ratios.get("a", Fraction(1))),
            Part("b", mass(2.0), ratio=ratios.get("b", Fraction(1))),
        ],
        [
            "a.position -> link.one",
            "b.position -> link.other",
            "link.on_one -> a.force",
            "link.on_other -> b.force",
        ],
    )


def simulated(system, name, steps, stop=2, **options):
    recorder, ledger = Recorder(system), Ledger(system, **options)
    grid = Grid(Fraction(0), Fraction(stop, steps), steps)
    simulate(system, create_master(name), grid, [recorder], ledger=ledger)
    return recorder.results(), ledger


def energy(results):
    kinetic = 0.5 * results["a.velocity"] ** 2 + results["b.velocity"] ** 2
    return kinetic + results["link.energy"]


def created(ledger):
    return sum(account.created for account in ledger.accounts().values())
