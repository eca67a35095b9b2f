"""Table of the search by unknown inputs: place, law, share of the gap closed on held-out runs, time.

    python tests/benchmarks/unknown_input.py FOLDER...

Each folder holds study.yaml, its logs and Modelica models, which are built into a copy.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from orchestrator.base.errors import OrchestratorError
from orchestrator.diagnosis.study.reader import load_port_study
from orchestrator.diagnosis.study.study import is_port_study
from orchestrator.diagnosis.unknown_input.answer import Answer, answer


def built(folder: Path, into: Path) -> Path:
    """A copy of a folder with its models built."""
    copy = into / folder.name
    shutil.copytree(folder, copy, copy_function=shutil.copyfile)
    copy.chmod(0o755)
    for model in sorted(copy.glob("*.mo")):
        subprocess.run(
            [sys.executable, "-m", "orchestrator", "build", model.name, "-o", f"{model.stem}.fmu"],
            cwd=copy, check=True, capture_output=True,
        )  # fmt: skip
    return copy


def row(name: str, found: Answer) -> str:
    """One line of the table."""
    laws = [one.name for one in found.fitted.laws] if found.fitted and found.verdict == "law" else []
    numbers = " ".join(f"{one:.4g}" for one in found.fitted.numbers) if laws and found.fitted else "-"
    cells = [
        name, found.verdict, " + ".join(laws) or "-", numbers, f"{100 * found.probability:.0f} %",
        f"{found.gap:.1f}", f"{found.calibrated:.1f}", f"{found.remains:.1f}", f"{100 * found.closed:.0f} %",
        f"{found.seconds:.0f} s",
    ]  # fmt: skip
    return "| " + " | ".join(cells) + " |"


def main(folders: list[str]) -> None:
    """Print the table."""
    print("| study | verdict | laws | numbers | probability | gap | calibrated | remains | closed | time |")
    print("|" + "---|" * 10)
    with tempfile.TemporaryDirectory() as scratch:
        for folder in map(Path, folders):
            copy = built(folder, Path(scratch))
            for study in sorted(one for one in copy.glob("*.yaml") if is_port_study(one)):
                name = folder.name if study.name == "study.yaml" else f"{folder.name}/{study.name}"
                try:
                    print(row(name, answer(load_port_study(study))), flush=True)
                except OrchestratorError as error:
                    print(f"| {name} | not run: {str(error).splitlines()[0]} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
