"""A measured system: a positioning drive, as handed over without what is to be found.

The data stand outside the checkout. The model knows mass, viscous friction and control law of the drive.
"""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from scipy.io import loadmat, savemat

from orchestrator.diagnosis.unknown_input.diagnose import diagnose_system

REAL = Path(__file__).parents[3] / "shared" / "gap" / "real"


def needed(*names):
    """Paths of files; skips without them."""
    paths = [REAL / name for name in names]
    if not all(path.is_file() for path in paths):
        pytest.skip(f"measurements are not there: {REAL}")
    return paths


@pytest.mark.filterwarnings("default::RuntimeWarning")  # of trials that run away
def test_the_drive_lacks_dry_friction(tmp_path):
    """EMPS: dry friction first; the drive's force within 4 % in a run with force pulses that no fit saw."""
    known, pulses = needed("emps/DATA_EMPS.mat", "emps/DATA_EMPS_PULSES.mat")
    # What is called pulses_N is added to the voltage after the control law: vir - kv (kp (qg - qm) - d qm/dt)
    # is 1.01 times it. On the mass it acts as the drive's force of so many volts.
    log = {name: column for name, column in loadmat(pulses).items() if not name.startswith("__")}
    log["load"] = log["gtau"] * log["pulses_N"]
    log["vir"] = log["vir"] - log["pulses_N"]
    savemat(tmp_path / "pulses.mat", log)
    study = {
        "format": "port-study/1",
        "system": "emps",
        "columns": {
            "path.position": {"column": "qg", "unit": "m"},
            "drive.position": {"column": "qm", "unit": "m", "noise": "10 um", "feed": False, "start": True},
            "controller.voltage": {"column": "vir", "unit": "V", "noise": "20 mV", "feed": False},
            "drive.load": {"column": "load", "unit": "N"},
        },
        "calibrated": {
            "drive.mass": {"tolerance": "5 kg"},
            "drive.viscous_friction": {"tolerance": "20 N.s/m"},
        },
        "settle": "0.3 s",
        "runs": [
            {"file": str(known), "role": "train", "to": "12.5 s", "without": ["drive.load"]},
            {"file": str(known), "role": "validation", "from": "12.5 s", "without": ["drive.load"]},
            {"file": "pulses.mat", "role": "held-out"},
        ],
    }
    (tmp_path / "emps.yaml").write_text(yaml.safe_dump(study))
    found = diagnose_system(tmp_path / "emps.yaml").data
    assert found["verdict"] == "law"
    law = found["laws"][0]
    assert (law["place"], law["signal"]) == ("drive.load", "drive.velocity") and "friction" in law["family"]
    assert found["held_out"]["closed"] > 0.75
    # Published: 95.1 kg, 203.5 N.s/m, 20.4 N.
    assert abs(law["numbers"]["level"]["value"]) == pytest.approx(20.4, rel=0.07)
    assert found["parameters"]["drive.viscous_friction"]["value"] == pytest.approx(203.5, rel=0.07)
    assert found["parameters"]["drive.mass"]["value"] == pytest.approx(95.1, rel=0.05)
