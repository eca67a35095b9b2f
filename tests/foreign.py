"""FMUs such as other tools make them, compiled for the tests."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp

import fmpy

SOURCES = Path(__file__).parent / "fmu_sources"


@lru_cache
def _library(source: str, version: int) -> bytes:
    folder = Path(mkdtemp(prefix="foreign-"))
    output = folder / f"library{fmpy.sharedLibraryExtension}"
    command = [sys.executable, "-m", "ziglang", "cc", "-shared", "-fPIC", "-O1", "-fno-sanitize=all", "-w"]
    command += [f"-DFMI={version}", "-o", str(output), str(SOURCES / source)]
    subprocess.run(command, check=True, capture_output=True)
    data = output.read_bytes()
    for file in folder.iterdir():
        file.unlink()
    folder.rmdir()
    return data


def document(name: str) -> str:
    """A model description, with capital words for what the tests fill in."""
    return (SOURCES / f"{name}.xml").read_text(encoding="utf-8")


def pack(path: Path, source: str, version: int, identifier: str, xml: str) -> Path:
    """An FMU of a C source and a model description."""
    platform = fmpy.platform_tuple if version == 3 else fmpy.platform
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", xml)
        archive.writestr(
            f"binaries/{platform}/{identifier}{fmpy.sharedLibraryExtension}", _library(source, version)
        )
    return path


_SLAVE1 = """<Implementation><CoSimulation_StandAlone>
    <Capabilities canHandleVariableCommunicationStepSize="true" canBeInstantiatedOnlyOncePerProcess="true"/>
  </CoSimulation_StandAlone></Implementation>"""


def bounce(path: Path, version: int, *, slave: bool = False, smooth: bool = False) -> Path:
    """The ball of bounce.c, for model exchange; with `slave` for FMI 1.0 co-simulation.

    `smooth`: its input is continuous.
    """
    xml = document(f"bounce{version}").replace("IMPLEMENTATION", _SLAVE1 if slave else "")
    if smooth:
        xml = xml.replace('valueReference="3"', 'valueReference="9"').replace(' variability="discrete"', "")
    return pack(path, "bounce.c", version, "Bounce", xml)


def wild(path: Path, capabilities: str = 'canHandleVariableCommunicationStepSize="true"') -> Path:
    """The FMU of wild.c."""
    return pack(path, "wild.c", 2, "Wild", document("wild").replace("VARIABLE", capabilities))


def arrays(path: Path, more: str = "") -> Path:
    """The FMU of arrays.c; `more` are further variables."""
    return pack(path, "arrays.c", 3, "Arrays", document("arrays").replace("MORE", more))


def flexible(path: Path, more: str = "") -> Path:
    """The FMU of flexible.c; `more` are further variables."""
    return pack(path, "flexible.c", 3, "Flexible", document("flexible").replace("MORE", more))


def flawed(path: Path, flaw: str = "none", **attributes: str) -> Path:
    """The FMU of flawed.c with a flaw; `attributes` are those of its parameter's Real element."""
    more = " ".join(f'{name}="{value}"' for name, value in attributes.items())
    return pack(path, "flawed.c", 2, "Flawed", document("flawed").replace("FLAW", flaw).replace("GAIN", more))


WITHIN = 'providesIntermediateUpdate="true" canReturnEarlyAfterIntermediateUpdate="true"'


def within(path: Path, capabilities: str = WITHIN) -> Path:
    """The FMU of within.c."""
    return pack(path, "within.c", 3, "Within", document("within").replace("CAPABILITIES", capabilities))


@lru_cache
def _quirky_libraries(helped: bool) -> tuple[bytes, bytes]:
    """The library of quirks.c and, where it is `helped`, the one it needs."""
    with TemporaryDirectory() as folder:
        suffix = fmpy.sharedLibraryExtension
        library, helper = Path(folder, f"Quirks{suffix}"), Path(folder, f"libhelper{suffix}")
        command = [
            sys.executable,
            "-m",
            "ziglang",
            "cc",
            "-shared",
            "-fPIC",
            "-O1",
            "-fno-sanitize=all",
            "-w",
        ]
        sources = [str(SOURCES / "quirks.c")]
        if helped:
            soname = ["-Wl,-soname,libhelper.so"] if sys.platform == "linux" else []
            make = [*command, *soname, "-o", str(helper), str(SOURCES / "helper.c")]
            subprocess.run(make, check=True, capture_output=True)
            sources += ["-DNEEDS_HELPER", f"-L{folder}", "-lhelper"]
        subprocess.run([*command, "-o", str(library), *sources], check=True, capture_output=True)
        return library.read_bytes(), helper.read_bytes() if helped else b""


def quirks(
    path: Path,
    habit: str = "",
    *,
    encoding: str = "utf-8",
    declared: str | None = None,
    helped: bool = False,
    resources: bool = False,
) -> Path:
    """The FMU of quirks.c with a habit.

    Args:
        encoding: of the model description; declared: what its first line says of it, nothing if empty.
        helped: whether its library needs another one that stands beside it.
        resources: whether it has any.
    """
    library, helper = _quirky_libraries(helped)
    said = encoding if declared is None else declared
    line = f'<?xml version="1.0" encoding="{said}"?>\n' if said else ""
    xml = line + document("quirks").replace("GUID", habit)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", xml.encode(encoding))
        archive.writestr(f"binaries/{fmpy.platform}/Quirks{fmpy.sharedLibraryExtension}", library)
        if helped:
            archive.writestr(f"binaries/{fmpy.platform}/libhelper{fmpy.sharedLibraryExtension}", helper)
        if resources:
            archive.writestr("resources/table.txt", "17\n")
    return path
