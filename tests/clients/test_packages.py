"""Our packages in other tools, closer than the matrix asks: transformations, step size, 1e-9."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.exchange.ssp.write import write_ssp
from tests.clients.job import job_of
from tests.clients.masters import CLIENTS
from tests.clients.trial import outcomes

# libcosim gives start values to parameters and inputs only: no satellite that moves at the start.
PUSHED = {
    "run": {"master": "jacobi", "step_size": "0.1 ms", "stop_time": "0.2 s"},
    "instances": {
        "robot": {
            "fmu": "RobotResponse",
            "start": {"omega_n": "25 Hz", "xi_n": 0.8, "tau_m": "2 ms", "command": "7 mm"},
        },
        "contact": {"fmu": "DockingContact", "start": {"stiffness": "176 N/mm", "front": "5 mm"}},
        "sensor": {"fmu": "ForceSensor", "start": {"cutoff": "200 Hz"}},
    },
    "connections": [
        {
            "from": "robot.position",
            "to": "contact.position",
            "through": [{"gain": 1.25}, {"offset": "-1 mm"}],
        },
        "robot.velocity -> contact.velocity",
        "contact.force -> sensor.force",
    ],
}
# From rest at zero: Ecos and fmpy do not carry outputs to inputs before the first step.
FLYING = ("run.stop_time=0.5 s", "satellite.form=native")


@pytest.fixture(scope="module")
def packaged(tmp_path_factory):
    """By name: a package that loses nothing of what it says, as a job, and our results."""
    folder = tmp_path_factory.mktemp("packages")
    assert write_ssp(PUSHED, folder / "pushed.ssp").lost == ()
    write_ssp("docking-1d-uncompensated", folder / "flying.ssp", (*FLYING, "run.master=jacobi"))
    pushed = job_of("pushed", PUSHED, package=folder / "pushed.ssp")
    flying = job_of("flying", "docking-1d-uncompensated", FLYING, package=folder / "flying.ssp")
    assert np.ptp(pushed[1]["sensor.measured_force"]) > 100.0
    assert np.abs(flying[1]["contact.force"]).max() > 100.0
    # What inputs get at first is left to the packages.
    return {
        "pushed": (replace(pushed[0], watched=("sensor.measured_force",), initial={}), pushed[1]),
        "flying": (replace(flying[0], watched=("robot.position",), initial={}), flying[1]),
    }


@pytest.mark.parametrize(
    ("client", "name"),
    [("libcosimpy", "pushed"), ("ecospy", "pushed"), ("ecospy", "flying"), ("fmpy", "flying")],
)
def test_a_package_runs_there_as_here(client, name, packaged):
    """Libcosim takes the step size of the annotation, and evaluates transformations without delay."""
    if why := CLIENTS[client].absent():
        pytest.skip(why)
    (outcome,) = outcomes(client, [packaged[name]])
    assert outcome.deviation is not None, outcome.reason
    assert outcome.deviation <= 1e-9
