"""A short run loads nothing that it does not need: that is most of its time."""

from __future__ import annotations

import json
import subprocess
import sys

from benchmarks.start_up import ROOT, RUN

# Each takes from 20 ms to 1 s to import.
_HEAVY = ("numba", "scipy", "matplotlib", "pandas", "pyarrow", "control", "casadi", "rumoca", "tqdm")


def loaded(code: str) -> set[str]:
    script = f"{code}\nimport json, sys; print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return set(json.loads(done.stdout.splitlines()[-1]))


def test_importing_the_package_imports_no_library():
    found = loaded("import orchestrator")
    assert "orchestrator" in found
    assert not found & {*_HEAVY, "numpy", "pydantic", "fmpy", "yaml", "lxml"}


def test_a_short_run_imports_what_it_needs_and_no_more():
    found = loaded(f"import orchestrator.cli.main{RUN}")
    assert {"numpy", "pydantic", "fmpy", "orchestrator.simulation.loop"} <= found
    assert not found & set(_HEAVY)
    assert not {name for name in found if name.startswith("orchestrator.simulation.native.")} - {
        "orchestrator.simulation.native.choice"
    }
    # CVODE's libraries are for model exchange.
    assert "fmpy.sundials" not in found
