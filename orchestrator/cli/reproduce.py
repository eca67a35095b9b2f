"""The command `orchestrator reproduce`."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from ..base.errors import ConfigError, Interrupted, Problem
from ..docking.reproduction.page import headline, number, page, verdict
from ..docking.reproduction.reproduce import Reproduction, reproduce
from ..plotting.figures import save
from .arguments import add_json

# Not summary.json, which is a run's: a folder may hold both.
NAME = "reproduction.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    parser.add_argument(
        "--out", metavar="DIR", default="reproduction", help="folder to write to (default: reproduction)"
    )
    parser.add_argument(
        "--only", metavar="LIST", default="", help="figures, for example fig6,fig7 or fig3; all by default"
    )
    parser.add_argument("--jobs", metavar="N", type=int, help="number of processes (default: one per core)")
    parser.add_argument("--quiet", action="store_true", help="print errors only")
    add_json(parser)


def main(args: argparse.Namespace) -> int:
    """Reproduce and write. Returns: 0, or 1 if a run failed."""
    if args.jobs is not None and args.jobs < 1:
        raise ConfigError([Problem("--jobs", f"{args.jobs} processes", "1 or more")])
    folder = Path(args.out)
    only = [one.strip() for one in args.only.split(",") if one.strip()]
    try:
        (folder / "figures").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError([Problem("--out", f"cannot make the folder {folder} ({error})")]) from error
    try:
        made = reproduce(only, jobs=args.jobs, progress=not args.quiet and not args.json)
    except KeyboardInterrupt:
        raise Interrupted(
            "interrupted; nothing is kept of this reproduction, which is written when all runs are made\n"
            "  --only fig6,fig7 makes a part of it."
        ) from None
    write(made, folder)
    if args.json:
        report = {"exit_code": 1 if made.failed else 0, "folder": str(folder), **made.summary}
        print(json.dumps(report, allow_nan=False, ensure_ascii=False))
    elif not args.quiet:
        print(_text(made))
        print(f"Written to {folder}: reproduction.html, {NAME}, figures/")
    for message in made.failed:
        print(f"orchestrator: {message}", file=sys.stderr)
    return 1 if made.failed else 0


def write(made: Reproduction, folder: Path) -> None:
    """Write reproduction.html, reproduction.json and figures/NAME.png to an existing folder."""
    text = json.dumps(made.summary, indent=2, allow_nan=False, ensure_ascii=False)
    (folder / NAME).write_text(text + "\n", encoding="utf-8")
    (folder / "reproduction.html").write_text(page(made), encoding="utf-8")
    (folder / "figures").mkdir(exist_ok=True)
    for name, figure in made.figures.items():
        save(figure, folder / "figures" / f"{name}.png")


def _text(made: Reproduction) -> str:
    summary = made.summary
    lines = []
    for entry in summary["experiments"]:
        lines.append(entry["title"])
        for one in entry["quantities"]:
            unit = "" if one["unit"] == "1" else f" {one['unit']}"
            source = f"; source: {one['paper']}" if one["paper"] else ""
            ours = f"{number(one['ours'])}{unit}"
            lines.append(f"  {verdict(one['agrees']):10}  {one['figure']:5}  {one['text']}: {ours}{source}")
    lines.append(f"{headline(summary)} {summary['runs']} runs in {summary['wall_time']:.0f} s.")
    return "\n".join(lines)
