"""What comes with the package: FMUs and systems, found by name."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]
_SYSTEMS = _PACKAGE / "config" / "systems"
_NATIVE = "-native"


def _fmu_folder() -> Path:
    # A wheel carries the FMUs inside the package; a checkout has them beside it.
    installed = _PACKAGE / "_bundled" / "fmus"
    return installed if installed.is_dir() else _PACKAGE.parent / "fmus"


def fmu_names() -> tuple[str, ...]:
    """Names of the bundled FMUs, in alphabetical order; native forms go by the name of their FMU."""
    fmus = _fmus()
    return tuple(sorted(name for name in fmus if name.removesuffix(_NATIVE) not in fmus.keys() - {name}))


def find_fmu(name: str) -> Path | None:
    """Path of a bundled FMU; None if there is none of that name."""
    return _fmus().get(name)


def fmu_forms(name: str) -> dict[str, Path]:
    """The forms that a bundled FMU comes in, "python" and "native"; none if there is no choice."""
    fmus = _fmus()
    if name not in fmus or f"{name}{_NATIVE}" not in fmus:
        return {}
    return {"python": fmus[name], "native": fmus[f"{name}{_NATIVE}"]}


def _fmus() -> dict[str, Path]:
    return {path.stem: path for path in _fmu_folder().glob("*/*.fmu")}


def system_names() -> tuple[str, ...]:
    """Names of the bundled systems, in alphabetical order."""
    return tuple(sorted(path.stem for path in _SYSTEMS.glob("*.yaml")))


def find_system(name: str) -> Path | None:
    """Path of a bundled system's config; None if there is none of that name."""
    path = _SYSTEMS / f"{name}.yaml"
    return path if path.is_file() else None
