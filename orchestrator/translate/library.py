"""Rebuild the shipped FMUs from `modelica/`: `python -m orchestrator.translate.library`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from orchestrator.base.errors import BuildError

from .build import ALL, build
from .build_report import BuildReport


@dataclass(frozen=True)
class LibraryFmu:
    """One shipped FMU: `source` below modelica/, `file` below fmus/."""

    name: str
    source: str
    fmi_version: str

    @property
    def file(self) -> str:
        suffix = "" if self.fmi_version == "2.0" else "-fmi3"
        return f"{self.name}/{self.name}{suffix}.fmu"


LIBRARY: tuple[LibraryFmu, ...] = tuple(
    LibraryFmu(name, source, version)
    for name, source in (
        ("RobotResponse", "DockingHIL/RobotResponse.mo"),
        ("DockingContact", "DockingHIL/DockingContact.mo"),
        ("LabRobot", "DockingHIL/LabRobot.mo"),
        ("LabContact", "DockingHIL/LabContact.mo"),
        ("ForceSensor", "DockingHIL/ForceSensor.mo"),
        ("LabSensor", "DockingHIL/LabSensor.mo"),
        ("JointServos", "DockingHIL/JointServos.mo"),
        ("CartesianResponse", "DockingHIL/CartesianResponse.mo"),
        ("PointContact", "DockingHIL/PointContact.mo"),
        ("WrenchSensor", "DockingHIL/WrenchSensor.mo"),
        ("UncompensatedDocking", "DockingHIL/Examples/UncompensatedDocking.mo"),
        ("SmoothMotion", "Drives/SmoothMotion.mo"),
        ("CascadeControl", "Drives/CascadeControl.mo"),
        ("LinearDrive", "Drives/LinearDrive.mo"),
        ("CompliantDrive", "Drives/CompliantDrive.mo"),
        ("TankPair", "Processes/TankPair.mo"),
        ("LevelControl", "Processes/LevelControl.mo"),
        ("Area", "Power/Area.mo"),
        ("CoulombDamper", "Drives/CoulombDamper.mo"),
        ("FrictionForce", "Drives/FrictionForce.mo"),
    )
    for version in ("2.0", "3.0")
)
"""Every FMU that is built from Modelica and shipped in fmus/."""


def build_library(
    root: Path, *, output: Path | None = None, names: Sequence[str] = (), platforms: Sequence[str] = ALL
) -> list[BuildReport]:
    """Rebuild the shipped FMUs.

    Args:
        root: the checkout, with the folders modelica/ and fmus/.
        output: folder to build into instead of fmus/.
        names: which FMUs, by name; none named: all.
        platforms: to compile for.
    Returns: a report for each FMU.
    Raises: BuildError for an unknown name or a model that cannot be built.
    """
    known = dict.fromkeys(item.name for item in LIBRARY)
    unknown = [name for name in names if name not in known]
    if unknown:
        raise BuildError(f"no shipped FMU {', '.join(unknown)}; shipped: {', '.join(known)}")
    folder = root / "fmus" if output is None else output
    reports = []
    for item in LIBRARY:
        if names and item.name not in names:
            continue
        target = folder / item.file
        target.parent.mkdir(parents=True, exist_ok=True)
        reports.append(
            build(root / "modelica" / item.source, target, fmi_version=item.fmi_version, platforms=platforms)
        )
    return reports


def main(arguments: Sequence[str] | None = None) -> int:
    """Rebuild from the command line; returns 0, or 1 after an error."""
    parser = argparse.ArgumentParser(prog="python -m orchestrator.translate.library", description=__doc__)
    parser.add_argument("names", nargs="*", help="which FMUs (default: all)")
    parser.add_argument("--root", type=Path, default=Path(__file__).resolve().parents[2], help="the checkout")
    parser.add_argument("--output", type=Path, help="folder to build into instead of fmus/")
    options = parser.parse_args(arguments)
    try:
        for report in build_library(options.root, output=options.output, names=options.names):
            print(report.path)
    except BuildError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
