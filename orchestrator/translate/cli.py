"""The sub-command `build`: a Modelica file to an FMU."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from orchestrator.errors import BuildError

from .package import PLATFORMS

_DESCRIPTION = """Make a co-simulation FMU from a Modelica model, with C sources and binaries for
Linux, Windows and macOS. Needs the extra `build` (pip install 'orchestrator[build]'), no C compiler."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `orchestrator build`."""
    parser.description = _DESCRIPTION
    parser.add_argument(
        "model_file", type=Path, metavar="MODEL.mo", help="file of the model; its package is loaded"
    )
    parser.add_argument(
        "-o", "--output", type=Path, metavar="FILE.fmu", help="default: the model's name, here"
    )
    parser.add_argument("--model", metavar="NAME", help="model to build, if the file holds none or several")
    parser.add_argument(
        "--fmi", choices=("2.0", "3.0"), default="2.0", help="FMI version (default: %(default)s)"
    )
    parser.add_argument(
        "--platforms",
        metavar="LIST",
        default="all",
        help=f"some of {','.join(PLATFORMS)}; or all, or none for sources only (default: %(default)s)",
    )
    parser.add_argument(
        "--compiler",
        choices=("rumoca", "omc"),
        default="rumoca",
        help="rumoca: built in; omc: an installed OpenModelica (default: %(default)s)",
    )


def main(args: argparse.Namespace) -> int:
    """Build; prints what was made. Returns 0, or 1 after an error, which is printed to stderr."""
    from .build import build

    platforms = {"all": tuple(PLATFORMS), "none": ()}.get(
        args.platforms, tuple(name.strip() for name in args.platforms.split(","))
    )
    output = args.output or Path(f"{(args.model or args.model_file.stem).rpartition('.')[2]}.fmu")
    try:
        report = build(
            args.model_file,
            output,
            model=args.model,
            fmi_version=args.fmi,
            platforms=platforms,
            compiler=args.compiler,
        )
    except BuildError as error:
        print(error, file=sys.stderr)
        return 1
    print(f"{report.path}: {report.model}, FMI {report.fmi_version} co-simulation")
    if report.counts:
        print("  " + ", ".join(f"{number} {what}" for what, number in report.counts.items()))
    print(f"  binaries: {', '.join(report.platforms) or 'none'}")
    for note in report.notes:
        print(f"  {note}")
    return 0
