"""Table of the search by unknown inputs: place, law, share of the gap closed on held-out runs, time.

    python tests/benchmarks/unknown_input.py FOLDER...
    python tests/benchmarks/unknown_input.py --measured FOLDER [NAME...]

Each folder holds study.yaml, its logs and Modelica models, which are built into a copy. With --measured,
FOLDER holds the logs of measured machines, each in a folder of its own. What `measured_machines/` has under
the same name, models and studies, is added there. The time is that of the processors, which hardly depends on
other programs.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from orchestrator.base.errors import OrchestratorError
from orchestrator.diagnosis.study.reader import load_port_study
from orchestrator.diagnosis.study.study import is_port_study
from orchestrator.diagnosis.unknown_input.answer import Answer
from orchestrator.diagnosis.unknown_input.inquiry import answer

MEASURED = Path(__file__).parent / "measured_machines"
# Columns of the friction damper's logs, and what makes SI units of them.
_DAMPER = {"time [s]": 1.0, "displacement [m]": 0.0254, "force [N]": 4448.2216, "velocity [m/s]": 0.0254}


def built(folder: Path, into: Path) -> Path:
    """A copy of a folder with its models built, and with what `measured_machines/` adds."""
    copy = into / folder.name
    shutil.copytree(folder, copy, copy_function=shutil.copyfile)
    copy.chmod(0o755)
    if (MEASURED / folder.name).is_dir():
        shutil.copytree(MEASURED / folder.name, copy, copy_function=shutil.copyfile, dirs_exist_ok=True)
    for logs in copy.glob("*amplitude.json"):
        rows = np.array(json.loads(logs.read_text(encoding="utf-8"))["data"])
        table = rows[:, : len(_DAMPER)] * list(_DAMPER.values())
        header = ",".join(_DAMPER)
        np.savetxt(logs.with_suffix(".csv"), table, "%.9g", ",", header=header, comments="")
    for model in sorted(copy.glob("*.mo")):
        subprocess.run(
            [sys.executable, "-m", "orchestrator", "build", model.name, "-o", f"{model.stem}.fmu"],
            cwd=copy, check=True, capture_output=True,
        )  # fmt: skip
    return copy


def row(name: str, found: Answer, seconds: float) -> str:
    """One line of the table.

    Args:
        seconds: of the processors.
    """
    laws = [one.name for one in found.fitted.laws] if found.fitted and found.verdict == "law" else []
    numbers = " ".join(f"{one:.4g}" for one in found.fitted.numbers) if laws and found.fitted else "-"
    cells = [
        name, found.verdict, " + ".join(laws) or "-", numbers, f"{100 * found.probability:.0f} %",
        f"{found.gap:.1f}", f"{found.calibrated:.1f}", f"{found.remains:.1f}", f"{100 * found.closed:.0f} %",
        f"{seconds:.0f} s",
    ]  # fmt: skip
    return "| " + " | ".join(cells) + " |"


def main(arguments: list[str]) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folders", nargs="*", type=Path, metavar="FOLDER", help="or names, with --measured")
    parser.add_argument("--measured", type=Path, metavar="FOLDER", help="with logs of measured machines")
    options = parser.parse_args(arguments)
    folders = options.folders
    if options.measured is not None:
        every = sorted(one for one in options.measured.iterdir() if one.is_dir())
        folders = [options.measured / one for one in folders] or every
    print("| study | verdict | laws | numbers | probability | gap | calibrated | remains | closed | time |")
    print("|" + "---|" * 10)
    with tempfile.TemporaryDirectory() as scratch:
        for folder in folders:
            copy = built(folder, Path(scratch))
            for study in sorted(one for one in copy.glob("*.yaml") if is_port_study(one)):
                name = folder.name if study.name == "study.yaml" else f"{folder.name}/{study.name}"
                try:
                    begin = sum(os.times()[:4])
                    found = answer(load_port_study(study))
                    print(row(name, found, sum(os.times()[:4]) - begin), flush=True)
                except OrchestratorError as error:
                    print(f"| {name} | not run: {str(error).splitlines()[0]} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
