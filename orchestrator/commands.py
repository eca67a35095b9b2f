"""What the commands that belong to no package of their own do: run, check, export-results, schema, list.

Their arguments, too, and those of `stability`, whose own module takes long to import.
"""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import argparse
    from collections.abc import Mapping, Sequence

    from .config import Config
    from .prepared import Prepared

__all__ = [
    "add_check_arguments",
    "add_config",
    "add_export_results_arguments",
    "add_json",
    "add_run_arguments",
    "add_stability_arguments",
    "check",
    "export_results",
    "list_known",
    "run",
    "schema",
    "tell",
]


def add_config(parser: argparse.ArgumentParser, several: bool = False) -> None:
    """Declare the config that a command takes, or several, and overrides of it."""
    parser.add_argument(
        "config",
        nargs="+" if several else None,
        metavar="NAME|CONFIG",
        help="a bundled system, a YAML file, an .fmu file, or a .ssp or .ssd file",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="PATH=VALUE",
        dest="overrides",
        help='change a value, for example robot.tau_m="6 ms" or run.step_size="50 us", of a single FMU '
        "start.k=3; may be given again",
    )


def _add_requests(parser: argparse.ArgumentParser) -> None:
    """Declare what a run is asked for besides its config; see `_asked`."""
    parser.add_argument(
        "--input",
        metavar="CSV",
        help="a file of signals over time: time [s], and a column for each input that it feeds, as force [N]",
    )
    for key in ("stop-time", "step-size"):
        parser.add_argument(
            f"--{key}", metavar="TIME", help=f"short for --set run.{key.replace('-', '_')}=..."
        )
    parser.add_argument(
        "--record",
        action="append",
        default=[],
        metavar="PATTERN",
        help='record further variables, for example "der(*)" or "robot.*"; may be given again',
    )


def add_json(parser: argparse.ArgumentParser) -> None:
    """Declare the option that `tell` heeds."""
    parser.add_argument("--json", action="store_true", help="print JSON, one line a result, and no text")


def add_run_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `orchestrator run`."""
    add_config(parser, several=True)
    _add_requests(parser)
    parser.add_argument(
        "--out",
        metavar="DIR",
        help="write results, summary and figures to this folder; with several systems, one folder each in it",
    )
    parser.add_argument(
        "--format", default="csv", metavar="LIST", help="formats besides results.arrow: csv, parquet, mat, h5"
    )
    parser.add_argument(
        "--no-halving", action="store_true", help="do not run again with half the step size for `numerics`"
    )
    parser.add_argument(
        "--realtime", action="store_true", help="pace the run by the clock; run.realtime.* has the options"
    )
    parser.add_argument(
        "--speed", type=float, metavar="X", help="simulated seconds per second; implies --realtime"
    )
    parser.add_argument("--no-figures", action="store_true", help="draw nothing")
    parser.add_argument("--quiet", action="store_true", help="print errors only")
    add_json(parser)


def add_check_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `orchestrator check`."""
    add_config(parser)
    _add_requests(parser)
    parser.add_argument("-v", "--verbose", action="store_true", help="list the inputs without a connection")
    add_json(parser)


def add_stability_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `orchestrator stability`."""
    add_config(parser)
    parser.add_argument("--out", metavar="DIR", help="write stability.json and figures to this folder")
    add_json(parser)


def add_export_results_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `orchestrator export-results`."""
    parser.add_argument("folder", metavar="DIR", help="what `run --out` wrote to, or an .arrow file in it")
    parser.add_argument("--format", default="csv", metavar="LIST", help="formats: csv, parquet, mat, h5")
    add_json(parser)


def tell(args: argparse.Namespace, data: Mapping[str, Any]) -> bool:
    """Print a JSON object in one line, if that is asked for. Returns: whether it is."""
    if not getattr(args, "json", False):
        return False
    print(json.dumps(data, allow_nan=False, ensure_ascii=False, default=str))
    return True


def _asked(
    args: argparse.Namespace, configs: Sequence[str], overrides: Sequence[str] = ()
) -> tuple[Sequence[str | Config], list[str]]:
    """The configs that a command names, and the overrides that are still to be made."""
    overrides = [*args.overrides, *overrides]
    for key, value in (("stop_time", args.stop_time), ("step_size", args.step_size)):
        if value is not None:
            plain = value.strip().lstrip("+-").replace(".", "", 1).replace("e", "", 1).replace("-", "", 1)
            overrides.append(f"run.{key}={value} s" if plain.isdigit() else f"run.{key}={value}")
    if not args.input and not args.record:
        return configs, overrides
    from .requested import requested

    return [requested(one, overrides, inputs=args.input, record=args.record) for one in configs], []


def run(args: argparse.Namespace) -> int:
    """Run systems, and compare them where there are several. Returns: the exit code, as all below."""
    from .compare import run_each
    from .table import summary_text

    options = {
        "halving": not args.no_halving,
        "formats": [one.strip() for one in args.format.split(",") if one.strip()],
        "figures": not args.no_figures,
        "progress": not args.quiet and not args.json,
    }
    overrides: list[str] = []
    if args.realtime or args.speed is not None:
        overrides.append(f"run.realtime.speed={1.0 if args.speed is None else args.speed!r}")

    def begin(one: Prepared) -> None:
        if not (args.quiet or args.json):
            named = f"{one.config.name}: " if len(args.config) > 1 else ""
            for note in one.notes:
                print(f"{named}note: {note}", file=sys.stderr)

    configs, overrides = _asked(args, args.config, overrides)
    for result in run_each(configs, out=args.out, overrides=overrides, begin=begin, **options):
        failed = (result.summary.get("numerics") or {}).get("error")
        folder = None if result.folder is None else str(result.folder)
        if tell(args, {"exit_code": 0, "folder": folder, "files": result.files, "summary": result.summary}):
            continue
        if not args.quiet:
            print(summary_text(result.summary))
            if result.folder is not None:
                print(f"Written to {result.folder}: {', '.join(result.files)}")
        elif failed:
            print(
                f"orchestrator: the run with half the step size failed: {failed['message']}", file=sys.stderr
            )
    return 0


def check(args: argparse.Namespace) -> int:
    """Tell what a config connects, without running it."""
    from .run import prepare

    (config,), overrides = _asked(args, [args.config])
    prepared = prepare(config, overrides)
    system, run = prepared.system, prepared.config.model.run
    unconnected = {
        f"{one.name}.{name}": one.variable(name).written(one.start[name])
        for one in system.instances
        for name in sorted(one.unconnected)
    }
    told = {
        "exit_code": 0,
        "name": prepared.config.name,
        "instances": {one.name: one.fmu.description.name for one in system.instances},
        "connections": [str(one) for one in system.connections],
        "order": [system.instances[index].name for index in system.order],
        "steps": prepared.grid.steps,
        "step_size": float(prepared.grid.step_size),
        "master": run.master_name,
        "bonds": [str(bond) for bond in system.bonds],
        "unconnected": unconnected,
        "notes": list(prepared.notes),
    }
    if tell(args, told):
        return 0
    print(f"{prepared.config.name}: {len(system.instances)} instances, {len(system.connections)} connections")
    for index in system.order:
        instance = system.instances[index]
        description = instance.fmu.description
        version = f", FMI {description.fmi_version}" if description.fmi_version else ""
        print(f"  {instance.name}: {description.name}{version}")
    print(f"order of direct feedthrough: {', '.join(system.instances[index].name for index in system.order)}")
    print(f"{prepared.grid.steps} steps of {run.step_size} to {run.stop_time}, {run.master_name}")
    for bond in system.bonds:
        print(f"power bond {bond}")
    if args.verbose:
        for port, value in unconnected.items():
            print(f"no connection: {port} = {value}")
    for note in prepared.notes:
        print(f"note: {note}")
    return 0


def export_results(args: argparse.Namespace) -> int:
    """Write recorded results in other formats."""
    from pathlib import Path

    from .errors import ConfigError, Problem
    from .formats import check_formats
    from .results import read_results

    suffixes = check_formats(args.format.split(","))
    path = Path(args.folder)
    if not path.exists():
        raise ConfigError([Problem(str(path), "no such folder", "what `run --out` wrote to")])
    results = read_results(path)
    base = path / "results" if path.is_dir() else path
    for suffix in suffixes:
        results.write(base.with_suffix(f".{suffix}"))
    files = [f"{base.stem}.{one}" for one in suffixes]
    if tell(args, {"exit_code": 0, "folder": str(base.parent), "files": files, "rows": len(results)}):
        return 0
    print(f"{len(results)} rows written to {base.parent}: {', '.join(files)}")
    return 0


def schema(args: argparse.Namespace) -> int:
    """Print the JSON Schema of configs."""
    from .config import json_schema

    print(json.dumps(json_schema(), indent=2))
    return 0


def list_known(args: argparse.Namespace) -> int:
    """Print names of what is bundled or registered."""
    from . import bundled
    from .effects import effect_names
    from .master import master_names
    from .measures import measure_names

    known = {
        "systems": bundled.system_names(),
        "FMUs": bundled.fmu_names(),
        "masters": master_names(),
        "effects": effect_names(),
        "measures": measure_names(),
    }
    if tell(args, known):
        return 0
    for title, names in known.items():
        print(f"{title}:")
        for name in names:
            print(f"  {name}")
    return 0
