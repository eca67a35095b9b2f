"""The sub-command `build`: a Modelica or Python model to an FMU."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path

from orchestrator.base.atomic_files import replaceable
from orchestrator.base.errors import BuildError

from ..translate.build_report import BuildReport
from ..translate.package import PLATFORMS, this_platform

_DESCRIPTION = """Make an FMU for co-simulation from a Modelica model (of one with events for model exchange
as well), with C sources and a binary for this machine, or from a Python model: in its Python form
(pythonfmu), or in its native form, C sources and a binary made from the same code. For a release give
--platforms all: binaries for Linux, Windows and macOS. Needs the extra `build` (pip install
'orchestrator[build]'), no C compiler."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `orchestrator build`."""
    parser.description = _DESCRIPTION
    parser.add_argument(
        "model_file", type=Path, metavar="MODEL", help="a .mo file, whose package is loaded, or a .py file"
    )
    parser.add_argument(
        "-o", "--output", type=Path, metavar="FILE.fmu", help="default: named after the model, in this folder"
    )
    parser.add_argument(
        "--form",
        choices=("python", "native"),
        default="python",
        help="of a Python model: its code as it is, or compiled (default: %(default)s)",
    )
    compiled = parser.add_argument_group("Modelica models and native forms only")
    modelica = parser.add_argument_group("Modelica models only")
    modelica.add_argument("--model", metavar="NAME", help="model to build, if the file holds none or several")
    compiled.add_argument(
        "--fmi", choices=("2.0", "3.0"), default="2.0", help="FMI version (default: %(default)s)"
    )
    compiled.add_argument(
        "--platforms",
        metavar="LIST",
        default="this",
        help=f"some of {', '.join(PLATFORMS)}, or of linux64, win64, darwin64; or this, the platform of this "
        "machine; or all, or none for sources only (default: %(default)s)",
    )
    modelica.add_argument(
        "--library",
        type=Path,
        action="append",
        default=[],
        metavar="DIR",
        help="a folder with a Modelica library, beside those of MODELICAPATH; may be given several times",
    )
    modelica.add_argument(
        "--compiler",
        choices=("rumoca", "omc"),
        default="rumoca",
        help="rumoca: built in; omc: an installed OpenModelica (default: %(default)s)",
    )
    looks = modelica.add_mutually_exclusive_group()
    looks.add_argument(
        "--check", action="store_true", help="list all faults of the model at once, and build nothing"
    )
    looks.add_argument(
        "--show",
        choices=("flat", "blocks"),
        help="print the flat model as Modelica, or the sorted blocks of its equations, and build nothing",
    )
    parser.add_argument("--json", action="store_true", help="print JSON, and no text")


def main(args: argparse.Namespace) -> int:
    """Build and print what was made.

    Args:
        args: as declared by `add_arguments`.
    Returns: 0; 1 if --check finds faults.
    Raises: BuildError for what cannot be built.
    """
    file: Path = args.model_file
    if not file.exists():  # before anything about what a build needs
        raise BuildError(f"{file}: no such file; give the .mo or .py file of a model")
    if (args.check or args.show) and file.suffix != ".mo":
        raise BuildError(f"{file}: --check and --show are for Modelica models; give a .mo file")
    if args.check:
        return _check(args)
    if args.show:
        from ..translate.show import show_model

        text = show_model(file, args.show, model=args.model, libraries=args.library)
        print(
            json.dumps({"exit_code": 0, args.show: text}, ensure_ascii=False) if args.json else text, end=""
        )
        return 0
    output: Path = args.output or Path(f"{(args.model or file.stem).rpartition('.')[2]}.fmu")
    replaceable(output, (".fmu",), "--output")
    if file.suffix == ".py" and args.form == "native":
        from ..translate.native_form import build_native_fmu

        chosen = _platforms(args.platforms)
        _print(build_native_fmu(file, output, fmi_version=args.fmi, platforms=chosen), args.json)
        return 0
    if file.suffix == ".py":
        from ..translate.python_fmu import build_python_fmu

        if args.fmi != "2.0" or args.platforms not in ("this", "all"):
            raise BuildError(
                f"{file}: --fmi and --platforms are for compiled FMUs; the Python form is of FMI 2.0, for "
                "Linux and Windows. Take --form native."
            )
        path = build_python_fmu(file, output)
        if args.json:
            from ..fmi import read_description

            built = {"path": str(path), "model": read_description(path).name, "fmi_version": "2.0"}
            print(json.dumps({"exit_code": 0, "form": "python", **built}, ensure_ascii=False))
        else:
            print(f"{path}: FMI 2.0 co-simulation, in Python")
        return 0
    if file.suffix != ".mo":
        raise BuildError(f"{file}: cannot recognise the kind of this model; give a .mo or a .py file")
    if args.form == "native":
        raise BuildError(f"{file}: --form is for Python models; Modelica models are always compiled")
    from ..translate.build import build

    # An installed OpenModelica compiles for this machine, whatever that is.
    chosen = () if (args.compiler, args.platforms) == ("omc", "this") else _platforms(args.platforms)
    report = build(
        file,
        output,
        model=args.model,
        fmi_version=args.fmi,
        platforms=chosen,
        compiler=args.compiler,
        libraries=args.library,
    )
    _print(report, args.json)
    return 0


def _check(args: argparse.Namespace) -> int:
    """Print all faults of a Modelica model; returns whether there are any."""
    from ..translate.check import check_model

    found = check_model(args.model_file, model=args.model, libraries=args.library)
    code = int(bool(found.findings))
    if args.json:
        problems = [
            {
                "kind": one.kind,
                "places": [
                    {"file": file, "line": line, "column": column or None}
                    for file, line, column in one.fault.places
                ],
                "problem": one.fault.what,
                "details": [line.strip() for line in one.fault.details],
            }
            for one in found.findings
        ]
        data = {"exit_code": code, "model": found.model, "problems": problems}
        data |= {"unchecked": list(found.unchecked), "notes": list(found.notes)}
        print(json.dumps(data, ensure_ascii=False))
        return code
    if found.findings:
        print(found.text())
    for what in found.unchecked:
        print(f"Not checked because of these problems: {what}.")
    for note in found.notes:
        print(f"  {note}")
    count = len(found.findings)
    print(f"{args.model_file}: {f'{count} problem' + 's' * (count > 1) if count else 'no problems'}")
    return code


def _platforms(text: str) -> tuple[str, ...]:
    """Keys of `PLATFORMS` for what --platforms was given. Raises: BuildError if there is none for "this"."""
    if text == "this":
        return (this_platform(),)
    if text in ("all", "none"):
        return tuple(PLATFORMS) if text == "all" else ()
    return tuple(name.strip() for name in text.split(","))


def _print(report: BuildReport, as_json: bool) -> None:
    if as_json:
        built = {**asdict(report), "path": str(report.path)}
        print(json.dumps({"exit_code": 0, "form": "compiled", **built}, ensure_ascii=False))
        return
    print(report)
