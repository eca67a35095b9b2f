"""The command `orchestrator stability`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from .arguments import add_config, add_json

if TYPE_CHECKING:
    import argparse

__all__ = ["add_arguments"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `orchestrator stability`."""
    add_config(parser)
    parser.add_argument("--out", metavar="DIR", help="write stability.json and figures to this folder")
    add_json(parser)


def main(args: argparse.Namespace) -> int:
    """Analyse the loop of a system. Returns: the exit code."""
    from ..frequency.loop import Loop
    from ..frequency.report import stability, stability_figures, text
    from ..simulation.run import prepare

    prepared = prepare(args.config, args.overrides)
    report = stability(prepared)
    if not args.json:
        print(text(report))
    files = []
    if args.out is not None:
        from ..plotting.figures import save

        folder = Path(args.out)
        folder.mkdir(parents=True, exist_ok=True)
        content = json.dumps(report, indent=2, allow_nan=False, ensure_ascii=False)
        (folder / "stability.json").write_text(content + "\n", encoding="utf-8")
        files.append("stability.json")
        for name, figure in stability_figures(Loop.of(prepared)).items():
            save(figure, folder / f"{name}.png")
            files.append(f"{name}.png")
        if not args.json:
            print(f"Written to {folder}: {', '.join(files)}")
    if args.json:
        told = {"exit_code": 0, "folder": args.out, "files": files, **report}
        print(json.dumps(told, allow_nan=False, ensure_ascii=False))
    return 0
