"""The binaries behind systems that are exported as one FMU: `python -m orchestrator.translate.coupled`.

They are compiled once, and shipped: an export adds a system's FMUs and the data of its connections, and needs
no compiler. Their sources are the FMI interfaces of the runtime over runtime/coupled/.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from importlib import resources
from pathlib import Path

from orchestrator.base.errors import BuildError
from orchestrator.base.temporary_folders import scratch_root

from .package import PLATFORMS, FmiVersion, compile_library, interface_headers

_FOLDER = Path(__file__).parent / "binaries"
_VERSIONS: tuple[FmiVersion, ...] = ("2.0", "3.0")
_SHARED = ("log.c", "model.h", "runtime.h")
_NAME = "coupled"


def coupled_sources(fmi_version: FmiVersion) -> dict[str, bytes]:
    """The C files behind a system, by file name.

    Args:
        fmi_version: of the whole; the FMUs in it may be of FMI 2.0 and 3.0.
    Raises: BuildError if fmpy, which carries the headers of the FMI standard, is not installed.
    """
    runtime = resources.files("orchestrator.translate") / "runtime"
    number = fmi_version[0]
    wanted = (*_SHARED, f"fmi{number}.c", f"fmi{number}_absent.c")
    sources = {name: (runtime / name).read_bytes() for name in wanted}
    sources |= {item.name: item.read_bytes() for item in (runtime / "coupled").iterdir() if item.is_file()}
    for version in _VERSIONS:
        sources |= interface_headers(version)
    return {name: sources[name].replace(b"\r\n", b"\n") for name in sorted(sources)}


def binary(platform: str, fmi_version: FmiVersion) -> bytes:
    """The shipped binary for a key of `package.PLATFORMS`."""
    return _file(_FOLDER, platform, fmi_version).read_bytes()


def build_binaries(output: Path = _FOLDER, platforms: Sequence[str] = tuple(PLATFORMS)) -> list[Path]:
    """Compile the binaries again; the same sources give the same bytes.

    Args:
        output: the folder to write to, which is made if need be.
        platforms: keys of `package.PLATFORMS`.
    Returns: the files.
    Raises: BuildError if the compiler is missing or refuses a file.
    """
    output.mkdir(parents=True, exist_ok=True)
    written = []
    for version in _VERSIONS:
        with tempfile.TemporaryDirectory(prefix="fmu-sources-", dir=scratch_root()) as folder:
            for name, content in coupled_sources(version).items():
                (Path(folder) / name).write_bytes(content)
            for platform in platforms:
                # One at a time: FMI 2.0's universal file for Macs is joined at export.
                made = compile_library(Path(folder), _NAME, version, [platform], libraries=("dl",))
                path = _file(output, platform, version)
                path.write_bytes(made[platform])
                written.append(path)
    return written


def _file(folder: Path, platform: str, fmi_version: FmiVersion) -> Path:
    return folder / f"{_NAME}-fmi{fmi_version[0]}-{platform}.bin"


def main(arguments: Sequence[str] | None = None) -> int:
    """Rebuild from the command line; returns 0, or 1 after an error."""
    parser = argparse.ArgumentParser(
        prog="python -m orchestrator.translate.coupled", description=main.__doc__
    )
    parser.add_argument("--output", type=Path, default=_FOLDER, help="the folder to write to")
    try:
        for path in build_binaries(parser.parse_args(arguments).output):
            print(path)
    except BuildError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
