"""Directional derivatives: as FMUs give them, and as the iterative master begins with them."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from assembled import assemble
from doubles import FakeFmu, FakeInstance

from orchestrator.fmi import Capabilities, load_fmu
from orchestrator.master.iterative import Iterative
from orchestrator.results.recorders import Recorder
from orchestrator.simulation.grid import Grid
from orchestrator.simulation.loop import simulate
from orchestrator.system.assembly import Part

FOLDER = Path(__file__).parents[2] / "fmus" / "DockingContact"
CONTACT = {"stiffness": "176 N/mm", "damping": "0.5 N.s/mm", "front": "5 mm", "rear": "-5 mm"}
versions = pytest.mark.parametrize("file", ["DockingContact.fmu", "DockingContact-fmi3.fmu"])


@versions
def test_derivatives_of_an_fmu_by_port(file):
    instance = load_fmu(FOLDER / file).instantiate("contact")
    try:
        start = {"stiffness": 176e3, "damping": 500.0, "front": 5e-3, "rear": -5e-3}
        instance.enter_initialisation(0.0, start | {"position": 6e-3, "velocity": 0.01}, 1.0)
        instance.exit_initialisation()
        matrix = instance.output_derivatives(["penetration", "force"], ["velocity", "position"])
    finally:
        instance.free()
    assert matrix.shape == (2, 2)
    assert matrix[1] == pytest.approx([-500.0, -176e3])
    assert abs(matrix[0, 1]) == pytest.approx(1.0) and matrix[0, 0] == 0.0


class Compliant(FakeInstance):
    """A rod that gives way: position = rest + compliance * force; notes each call for its derivative."""

    def output_derivatives(self, outputs, inputs):
        self._note("derivatives")
        assert (list(outputs), list(inputs)) == (["position"], ["force"])
        return np.array([[1e-5]])


def rod():
    made = FakeFmu(
        inputs={"force": "N"},
        outputs={"position": "m", "velocity": "m/s"},
        feedthrough={"position": ["force"]},
        output=lambda values: {"position": 7e-3 + 1e-5 * values["force"], "velocity": 0.0},
        capabilities=Capabilities(save_state=True, directional_derivatives=True),
    )
    made.instantiate = lambda name: Compliant(name, made)
    return made


@versions
@pytest.mark.parametrize("derivatives", ["offered", "differences"])
def test_a_loop_through_a_contact_is_solved_with_either_slope(file, derivatives):
    bar = rod()
    system = assemble(
        [Part("rod", bar), Part("contact", load_fmu(FOLDER / file), {**CONTACT, "velocity": "0 m/s"})],
        ["rod.position -> contact.position", "contact.force -> rod.force"],
        loops=True,
    )
    recorder = Recorder(system)
    master = Iterative(tolerance=1e-12, derivatives=derivatives)
    simulate(system, master, Grid(Fraction(0), Fraction(1, 100), 3), [recorder])
    results = recorder.results()
    # force = -k (7 mm + force / 1e5 - 5 mm): a loop gain of -1.76, from which a fixed point runs away.
    exact = -176e3 * 2e-3 / (1.0 + 176e3 * 1e-5)
    assert results["contact.force"] == pytest.approx(np.full(4, exact), rel=1e-11)
