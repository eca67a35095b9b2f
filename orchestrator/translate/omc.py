"""Build an FMU with OpenModelica's compiler, for what the built-in route does not support."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

from orchestrator.base.errors import BuildError
from orchestrator.base.temporary_folders import scratch_root

from .build_report import BuildReport
from .sources import load_sources

_TIME_LIMIT = 1800.0


def build_with_omc(model_file: Path, output: Path, *, model: str | None, fmi_version: str) -> BuildReport:
    """Have `omc` build a co-simulation FMU for this computer's platform.

    Tested against the scripted interface only (a stand-in for omc that reads the script it is given), not
    against an installed OpenModelica.

    Args:
        model_file, output, model: as for `build`.
        fmi_version: "2.0"; OpenModelica's export of FMI 3.0 is not used.
    Returns: a report without counts.
    Raises: BuildError if omc is not on the PATH, is asked for FMI 3.0 or does not make an FMU.
    """
    if fmi_version != "2.0":
        raise BuildError(
            f"--compiler omc makes FMI 2.0 only, got {fmi_version}; drop --fmi or use --compiler rumoca"
        )
    command = shutil.which("omc")
    if command is None:
        raise BuildError(
            "--compiler omc: `omc` is not on the PATH; install OpenModelica (https://openmodelica.org) or "
            "use --compiler rumoca"
        )
    tree = load_sources(model_file)
    name = tree.model_name(model)
    top = tree.root / name.partition(".")[0] / "package.mo"
    library = top if top.is_file() else tree.root / tree.main
    prefix = name.rpartition(".")[2]
    with tempfile.TemporaryDirectory(prefix="omc-", dir=scratch_root()) as folder:
        script = Path(folder) / "build.mos"
        script.write_text(omc_script(library, name, prefix), encoding="utf-8")
        try:
            result = subprocess.run(
                [command, script.name],
                cwd=folder,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=_TIME_LIMIT,
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise BuildError(f"{model_file}: {command} could not be run: {error}") from error
        built = Path(folder) / f"{prefix}.fmu"
        if result.returncode != 0 or not built.is_file():
            message = "\n".join(f"  {line}" for line in (result.stdout + result.stderr).strip().splitlines())
            raise BuildError(
                f"{model_file}: omc made no FMU of {name} (exit status "
                f"{result.returncode})\n{message or '  no message'}"
            )
        shutil.move(built, output)
    notes = (
        "built by OpenModelica: delays directly on an output and rollback are known to be at fault in its "
        "FMUs",
    )
    return BuildReport(output, name, fmi_version, (), {}, notes)


def omc_script(library: Path, model: str, prefix: str) -> str:
    """The script that omc runs: load a library, build the FMU `prefix`.fmu of a model, print the messages.

    Args:
        library: package.mo of the library, or the file of the model.
        model: qualified name.
        prefix: file name of the FMU without its ending.
    """
    path = library.as_posix().replace("\\", "\\\\").replace('"', '\\"')
    return (
        f'if not loadFile("{path}") then\n'
        "  print(getErrorString());\n"
        "  exit(1);\n"
        "end if;\n"
        f'buildModelFMU({model}, version="2.0", fmuType="cs", fileNamePrefix="{prefix}", '
        'platforms={"static"});\n'
        "print(getErrorString());\n"
    )
