"""The commands `new`, `export` and `import`: configs from FMUs, and systems in other tools' formats."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from pathlib import Path

from ..base.errors import ConfigError, Problem, listed
from .arguments import add_config


def _export_ssp(args: argparse.Namespace) -> int:
    from ..exchange.ssp.write import write_ssp

    written = write_ssp(args.config, args.output, args.overrides, args.ssp_version)
    print(f"{written.path}: SSP {written.version}")
    if written.carried:
        print(f"  SSP has no word for, carried as annotation: {listed(written.carried)}")
    for one in written.lost:
        print(f"  {one}")
    if written.code:
        print(f"  holds Python code of effects, taken by import --with-code alone: {listed(written.code)}")
    return 0


def _import_ssp(args: argparse.Namespace) -> int:
    from ..exchange.ssp.load import import_ssp
    from ..exchange.ssp.read import MAIN

    if args.output.is_file() and not args.overwrite:
        remedy = "Name another file, or give --overwrite: what was changed in that one by hand is lost then."
        raise ConfigError([Problem("--output", f"{args.output} is there already", remedy=remedy)])
    read = import_ssp(args.file, args.output, args.variant or MAIN, with_code=args.with_code)
    counts = (len(read.data.get(key, ())) for key in ("instances", "connections"))
    print("{}: {} instances, {} connections".format(args.output, *counts))
    for note in read.notes:
        print(f"  note: {note}")
    for key, remedy in read.remedies.items():
        print(f"  run.{key} is missing: {remedy}")
    return 0


def _export_fmu(args: argparse.Namespace) -> int:
    from ..exchange.system_fmu import export_system_fmu

    report = export_system_fmu(
        args.config,
        args.output,
        overrides=args.overrides,
        fmi_version=args.fmi if "." in args.fmi else f"{args.fmi}.0",
        ports=_names(args.ports),
        inputs=_names(args.inputs),
    )
    print(f"{report.path}: FMI {report.fmi_version} co-simulation, step size {report.step_size!r} s")
    counts = {"input": report.inputs, "output": report.outputs, "parameter": report.parameters}
    amounts = [f"{len(names)} {what}{'' if len(names) == 1 else 's'}" for what, names in counts.items()]
    print(f"  {', '.join(amounts)}")
    print(f"  binaries: {', '.join(report.platforms)}")
    for note in report.notes:
        print(f"  {note}")
    return 0


def _names(text: str | None) -> list[str] | None:
    """Names that commas divide, except within brackets: A[1,2]."""
    return None if text is None else [one.strip() for one in re.split(r",(?![^\[]*\])", text) if one.strip()]


# Suffix of what is written -> its function.
EXPORTS: dict[str, Callable[[argparse.Namespace], int]] = {".fmu": _export_fmu, ".ssp": _export_ssp}
IMPORTS: dict[str, Callable[[argparse.Namespace], int]] = {".ssp": _import_ssp, ".ssd": _import_ssp}


def add_export_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `orchestrator export`."""
    parser.description = "Write a system for other tools; the suffix of FILE chooses the format."
    add_config(parser)
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FILE", help=f"ends in {listed(EXPORTS)}"
    )
    ssp = parser.add_argument_group("system structure packages (.ssp)")
    ssp.add_argument("--ssp-version", choices=("1.0", "2.0"), help="default: 1.0 where that is enough")
    fmu = parser.add_argument_group("the system as one FMU (.fmu)")
    fmu.add_argument(
        "--fmi", choices=("2", "3", "2.0", "3.0"), default="2.0", help="FMI version (default: %(default)s)"
    )
    fmu.add_argument(
        "--ports", metavar="LIST", help="outputs, as a.b,c.d (default: every output of every instance)"
    )
    fmu.add_argument(
        "--inputs",
        metavar="LIST",
        help="inputs among those that nothing feeds, as a.b,c.d (default: all of these)",
    )


def add_import_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `orchestrator import`."""
    parser.description = "Make a config of another tool's system; FMUs are put into a folder beside it."
    parser.add_argument("file", type=Path, metavar="FILE", help=f"ends in {listed(IMPORTS)}")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="CONFIG", help="the YAML file")
    parser.add_argument("--overwrite", action="store_true", help="write over a config that is there")
    parser.add_argument("--variant", metavar="NAME.ssd", help="of the descriptions in a package (.ssp)")
    parser.add_argument(
        "--with-code", action="store_true", help="take Python code of effects, which runs with your rights"
    )


def add_new_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `orchestrator new`."""
    parser.description = (
        "Write a config to start from: the FMUs as instances, their ports as comments, and the connections "
        "for which name, type and unit fit in one way only."
    )
    parser.add_argument("fmus", nargs="+", type=Path, metavar="FMU", help="one named twice is taken twice")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="CONFIG", help="the YAML file")
    parser.add_argument("--overwrite", action="store_true", help="write over a config that is there")


def new_main(args: argparse.Namespace) -> int:
    """Write a config to start from. Returns: 0. Raises: ConfigError."""
    from ..exchange.new_config import starting_config
    from ..simulation.preparation import prepare

    if args.output.exists() and not args.overwrite:
        raise ConfigError(
            [Problem("", f"{args.output} exists", remedy="Choose another file or --overwrite.")]
        )
    text = starting_config(args.fmus, args.output)
    try:
        args.output.parent.mkdir(parents=True, exist_ok=True)
        args.output.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError([Problem(str(args.output), f"cannot be written ({error})")]) from error
    print(f"{args.output}: {len(args.fmus)} instances, {text.count('  - ')} connections")
    try:
        prepare(args.output)
    except ConfigError as error:
        print(f"To be settled before it runs:\n{error}")
    return 0


def export_main(args: argparse.Namespace) -> int:
    """Export. Returns: 0. Raises: ConfigError for what cannot be exported."""
    return _chosen(EXPORTS, args.output, "cannot derive the format from the file name")(args)


def import_main(args: argparse.Namespace) -> int:
    """Import. Returns: 0. Raises: ConfigError for what cannot be imported."""
    found = _chosen(IMPORTS, args.file, "cannot recognise the kind of this file")
    if not args.file.is_file():
        raise ConfigError([Problem("", f"no file {args.file}")])
    return found(args)


def _chosen(
    known: dict[str, Callable[[argparse.Namespace], int]], path: Path, what: str
) -> Callable[[argparse.Namespace], int]:
    if path.suffix.lower() not in known:
        raise ConfigError([Problem(str(path), what, f"suffixes: {listed(known)}")])
    return known[path.suffix.lower()]
