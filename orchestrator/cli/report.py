"""The sub-command `report`."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..base.atomic_files import replaceable
from ..base.errors import ConfigError, Problem


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `orchestrator report`."""
    parser.description = (
        "Make one HTML page, which needs no network, of what other commands wrote: a run (finished, failed "
        "or killed), several runs side by side, the store of a sweep, a reproduction, a diagnosis."
    )
    parser.add_argument(
        "folders", nargs="+", type=Path, metavar="DIR", help="folder of a run, or several; a store"
    )
    parser.add_argument(
        "-o",
        "--out",
        type=Path,
        metavar="FILE",
        help="the page to write (default: report.html in the first folder)",
    )
    parser.add_argument(
        "--size", type=float, default=8.0, metavar="MB",
        help="what recorded signals may take in the page; longer ones are thinned, peaks kept (default: 8)",
    )  # fmt: skip
    parser.add_argument("--quiet", action="store_true", help="print errors only")


def main(args: argparse.Namespace) -> int:
    """Make the page. Returns: 0. Raises: ConfigError if the folders hold nothing known."""
    if not 0.0 < args.size < 1000.0:
        raise ConfigError([Problem("--size", f"{args.size:g} MB", "more than 0 and less than 1000")])
    if args.out is not None:
        replaceable(args.out, (".html", ".htm"), "--out")
    # Imported late: drawing takes a second to load.
    from ..report.make import left_out, page_name, report

    text = report(args.folders, budget=round(1e6 * args.size))
    path = args.out or args.folders[0] / page_name(args.folders[0])
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError([Problem("--out", f"cannot write {path} ({error})")]) from error
    if not args.quiet:
        print(f"Written: {path} ({len(text.encode()) / 1e6:.1f} MB); open it in a browser")
        for one in left_out(args.folders):
            print(f"left out: {one}")
    return 0
