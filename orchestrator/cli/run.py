"""The command `orchestrator run`."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from .arguments import add_config, add_json, add_requests, print_json, requested_configs

if TYPE_CHECKING:
    import argparse

    from ..simulation.preparation import Prepared


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `orchestrator run`."""
    add_config(parser, several=True)
    add_requests(parser)
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


def main(args: argparse.Namespace) -> int:
    """Run systems, and compare them where there are several. Returns: the exit code, as all below."""
    from ..base.text_tables import summary_text
    from ..simulation.comparison import run_each

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

    configs, overrides = requested_configs(args, args.config, overrides)
    for result in run_each(configs, out=args.out, overrides=overrides, begin=begin, **options):
        failed = (result.summary.get("numerics") or {}).get("error")
        folder = None if result.folder is None else str(result.folder)
        if print_json(
            args, {"exit_code": 0, "folder": folder, "files": result.files, "summary": result.summary}
        ):
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
