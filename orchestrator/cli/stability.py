"""The command `orchestrator stability`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .arguments import add_config, add_json

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Mapping

    from ..simulation.preparation import Prepared

__all__ = ["add_arguments", "main"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `orchestrator stability`."""
    add_config(parser)
    parser.add_argument(
        "--open",
        action="append",
        default=[],
        metavar="INPUT",
        help="open the loop at what feeds this input, as drive.voltage; may be given again",
    )
    parser.add_argument("--out", metavar="DIR", help="write stability.json and figures to this folder")
    add_json(parser)


def main(args: argparse.Namespace) -> int:
    """Analyse a system. Returns: the exit code."""
    from ..frequency.loop import Loop
    from ..simulation.run import prepare

    prepared = prepare(args.config, args.overrides)
    # Docking loops have a report of their own, with growth per contact and charts.
    analyse = _docking_loop if Loop.fits(prepared.system) and not args.open else _any_system
    report, words, draw = analyse(prepared, args)
    if not args.json:
        print(words)
    files = []
    if args.out is not None:
        from ..plotting.figures import save

        folder = Path(args.out)
        folder.mkdir(parents=True, exist_ok=True)
        content = json.dumps(report, indent=2, allow_nan=False, ensure_ascii=False)
        (folder / "stability.json").write_text(content + "\n", encoding="utf-8")
        files.append("stability.json")
        for name, figure in draw().items():
            save(figure, folder / f"{name}.png")
            files.append(f"{name}.png")
        if not args.json:
            print(f"Written to {folder}: {', '.join(files)}")
    if args.json:
        document = {"exit_code": 0, "folder": args.out, "files": files, **report}
        print(json.dumps(document, allow_nan=False, ensure_ascii=False))
    return 0


_Analysis = tuple[dict[str, Any], str, "Callable[[], Mapping[str, Any]]"]


def _docking_loop(prepared: Prepared, args: argparse.Namespace) -> _Analysis:
    from ..frequency.loop import Loop
    from ..frequency.report import stability, stability_figures, text

    report = stability(prepared)
    return report, text(report), lambda: stability_figures(Loop.of(prepared))


def _any_system(prepared: Prepared, args: argparse.Namespace) -> _Analysis:
    from ..frequency.from_system import linearise
    from ..frequency.system_report import system_figures, system_stability, system_text

    linear = linearise(prepared)
    report = system_stability(prepared, args.open, linear)
    return report, system_text(report), lambda: system_figures(report, linear)
