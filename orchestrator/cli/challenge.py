"""`orchestrator challenge make | run | score`."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any

from ..base.errors import ConfigError, Interrupted, Problem
from ..results.file_formats import strict
from ..results.progress import counting

__all__ = ["add_arguments", "main"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the three commands."""
    parts = parser.add_subparsers(dest="part", required=True, metavar="make|run|score")
    make = parts.add_parser("make", help="make cases of a rig with hidden effects, and seal the truth")
    make.add_argument("folder", metavar="DIR", help="a new folder")
    make.add_argument("--cases", type=int, required=True, metavar="N")
    make.add_argument(
        "--seed",
        required=True,
        metavar="S",
        help="a whole number: the same one gives the same bytes; or `secret`: one that nobody knows",
    )
    make.add_argument(
        "--magnitude",
        type=float,
        metavar="M",
        help="of every effect, 1 is strong; without it each case draws its own, from 0.03 to 1.2",
    )
    make.add_argument("--pairs", action="store_true", help="hide two effects in a quarter of those with any")
    make.add_argument(
        "--outside",
        nargs="?",
        const="all",
        metavar="KINDS",
        help="hide effects outside the catalogue in a quarter of them: `known`, those that the makers of the "
        "diagnosis have seen; `fresh`, those that they have not; or `all` (what --outside alone means)",
    )
    make.add_argument(
        "--tight",
        type=float,
        default=1.0,
        metavar="F",
        help="have the lab state tolerances that are F times too tight",
    )
    run = parts.add_parser("run", help="diagnose every case that has no verdict yet")
    _add_folders(run)
    run.add_argument(
        "--by",
        metavar="MODULE:FUNCTION",
        help="what diagnoses: called with the folder of a case and that of its verdict; ours by default",
    )
    run.add_argument(
        "--scheduler",
        metavar="tcp://HOST:PORT",
        help="a Dask cluster that diagnoses (extra `cluster`); its workers have to see both folders",
    )
    score = parts.add_parser("score", help="open the truth, once all verdicts are written, and score them")
    _add_folders(score)
    for part in (make, run):
        part.add_argument("--jobs", type=int, default=os.cpu_count() or 1, metavar="N", help="processes")
    for part in (make, run, score):
        part.add_argument(
            "--debug", action="store_true", default=argparse.SUPPRESS, help="show tracebacks of errors"
        )
        part.add_argument("--json", action="store_true", help="print JSON, and no text")


def _add_folders(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", metavar="DIR", help="what `make` was given")
    parser.add_argument(
        "--verdicts", required=True, metavar="OUT", help="folder of verdicts, OUT/<case>/diagnosis.json"
    )


def main(args: argparse.Namespace) -> int:
    """Run what was asked. Returns: the exit code."""
    return {"make": _make, "run": _run, "score": _score}[args.part](args)


def _print_if_json(args: argparse.Namespace, data: Mapping[str, Any]) -> bool:
    """Print JSON in one line, if that is asked for. Returns: whether it is."""
    if args.json:
        print(json.dumps(strict(data), allow_nan=False, ensure_ascii=False))
    return args.json


@contextmanager
def _bar(total: int, label: str, shown: bool) -> Iterator[Callable[[str], None]]:
    """Counts cases on a terminal."""
    with counting(total, label, "case", shown) as tell:
        numbers = count(1)
        yield lambda name: tell(next(numbers), total)


def _seed(text: str) -> int | None:
    if text == "secret":
        return None
    try:
        return int(text)
    except ValueError:
        raise ConfigError([Problem("--seed", f"got {text!r}", "a whole number, or `secret`")]) from None


def _make(args: argparse.Namespace) -> int:
    from ..diagnosis.challenge.make import Order, make
    from ..diagnosis.challenge.seal import SEALED

    order = Order(args.cases, _seed(args.seed), args.magnitude, args.pairs, args.outside, args.tight)
    with _bar(order.cases, "make", not args.json) as progress:
        try:
            digest = make(Path(args.folder), order, _jobs(args), progress)
        except KeyboardInterrupt:
            raise Interrupted(
                f"interrupted; cases made until then are in {args.folder}, but their truth is sealed "
                "at the end alone: they can be diagnosed, not scored\n  Make them again in a new folder."
            ) from None
    report = {"folder": args.folder, "cases": order.cases, "sealed": SEALED, "sha256": digest}
    if _print_if_json(args, {"exit_code": 0, **report}):
        return 0
    print(f"{_cases(order.cases)} in {args.folder}; the truth is sealed in {SEALED}, SHA-256 {digest}")
    return 0


def _run(args: argparse.Namespace) -> int:
    from ..diagnosis.challenge.run import OURS, diagnose_all

    folder, verdicts = Path(args.folder), Path(args.verdicts)
    with _bar(len(list(folder.glob("*/case.yaml"))), "diagnose", not args.json) as progress:
        done, failed = diagnose_all(folder, verdicts, _jobs(args), args.by or OURS, progress, args.scheduler)
    status = 1 if failed else 0
    errors = [{"case": name, "message": error} for name, error in failed]
    report = {"exit_code": status, "verdicts": str(verdicts), "diagnosed": done, "failed": errors}
    if not _print_if_json(args, report):
        print(f"{_cases(done)} diagnosed; verdicts in {verdicts}")
    for name, error in failed:
        print(f"orchestrator: {name}: {error}", file=sys.stderr)
    return status


def _score(args: argparse.Namespace) -> int:
    from ..diagnosis.challenge.score import score, score_text, write_score

    out = Path(args.verdicts)
    found = score(Path(args.folder), out)
    write_score(out / "score.json", found)
    if _print_if_json(args, {"exit_code": 0, "file": str(out / "score.json"), "score": found}):
        return 0
    print(score_text(found))
    print(f"Written to {out / 'score.json'}")
    return 0


def _cases(count: int) -> str:
    return f"{count} case{'' if count == 1 else 's'}"


def _jobs(args: argparse.Namespace) -> int:
    if args.jobs < 1:
        raise ConfigError([Problem("--jobs", f"got {args.jobs}", "at least 1")])
    return args.jobs
