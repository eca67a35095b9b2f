"""`orchestrator challenge [system] ...` of any system, and `make | run | score` of a rig."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path

from ..base.errors import ConfigError, Interrupted, Problem
from ..config import load_config
from ..results.file_formats import strict
from ..results.progress import counting
from .arguments import one_matrix_thread, print_json

_DESCRIPTION = """Check diagnosis blind. `challenge CONFIG` and `challenge --random SEED` hide laws in a copy
of a system that an independent solver integrates, search its logs as `diagnose` does, and
score the verdicts. `make`, `run` and `score` do so for effects of a docking rig, with a sealed truth.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the four parts; `system` may be left out."""
    one_matrix_thread()
    parser.description = _DESCRIPTION
    parts = parser.add_subparsers(dest="part", required=True, metavar="[system]|make|run|score")
    _add_system(
        parts.add_parser("system", help="hide laws in random systems or in yours, search and score them")
    )
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
    system = parts.choices["system"]
    for part in (make, run, system):
        part.add_argument("--jobs", type=int, default=os.cpu_count() or 1, metavar="N", help="processes")
    for part in (make, run, score, system):
        part.add_argument(
            "--debug", action="store_true", default=argparse.SUPPRESS, help="show tracebacks of errors"
        )
        part.add_argument("--json", action="store_true", help="print JSON, and no text")


def _add_system(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "config",
        nargs="?",
        type=Path,
        metavar="CONFIG",
        help="a config, or a study.yaml with logs that drive it",
    )
    parser.add_argument(
        "--random",
        type=int,
        metavar="SEED",
        help="systems of 2 to 8 random parts; the same seed gives the same",
    )
    parser.add_argument("--seed", type=int, default=1, help="of the first case that CONFIG hides a law in")
    parser.add_argument(
        "--count", type=int, default=1, metavar="N", help="cases, with one seed after the other"
    )
    parser.add_argument(
        "--hide", choices=("none", "one", "two", "outside"),
        help="what each case hides: nothing, one law, two, or one that no library holds; drawn by default",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="continued where it stopped")


def _add_folders(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", metavar="DIR", help="what `make` was given")
    parser.add_argument(
        "--verdicts", required=True, metavar="OUT", help="folder of verdicts, OUT/<case>/diagnosis.json"
    )


def main(args: argparse.Namespace) -> int:
    """Run what was asked. Returns: the exit code."""
    return {"make": _make, "run": _run, "score": _score, "system": _system}[args.part](args)


def _system(args: argparse.Namespace) -> int:
    if (args.config is None) == (args.random is None):
        raise ConfigError(
            [Problem("challenge", "got both" if args.config else "got neither", "CONFIG or --random SEED")]
        )
    if args.count < 1:
        raise ConfigError([Problem("--count", f"got {args.count}", "at least 1")])
    first = args.seed if args.random is None else args.random
    if first < 0:
        raise ConfigError(
            [Problem("--random" if args.config is None else "--seed", f"got {first}", "at least 0")]
        )
    if args.config is not None:
        # Read before the search is imported, which takes seconds.
        from ..diagnosis.study.reader import load_port_study
        from ..diagnosis.study.study import is_port_study

        (load_port_study if is_port_study(args.config) else load_config)(args.config)
    from ..diagnosis.blind.run import Order, check
    from ..diagnosis.blind.score import summary_text

    order = Order(args.out, range(first, first + args.count), args.config, args.hide)
    with _bar(args.count, "challenge", not args.json) as progress:
        found = check(order, _jobs(args), progress)
    status = 1 if found["counts"]["failed"] else 0
    if not print_json(args, strict({"exit_code": status, "folder": str(args.out), "summary": found})):
        print(summary_text(found), end="")
        print(f"Written to {args.out / 'summary.md'}")
    return status


@contextmanager
def _bar(total: int, label: str, shown: bool) -> Iterator[Callable[[str], None]]:
    """Counts cases on a terminal."""
    with counting(total, label, "case", shown) as advance:
        numbers = count(1)
        yield lambda name: advance(next(numbers), total)


def _seed(text: str) -> int | None:
    if text == "secret":
        return None
    try:
        return int(text)
    except ValueError:
        raise ConfigError([Problem("--seed", f"got {text!r}", "a whole number, or `secret`")]) from None


def _make(args: argparse.Namespace) -> int:
    from ..diagnosis.rig.challenge.make import Order, make
    from ..diagnosis.rig.challenge.seal import SEALED

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
    if print_json(args, strict({"exit_code": 0, **report})):
        return 0
    print(f"{_cases(order.cases)} in {args.folder}; the truth is sealed in {SEALED}, SHA-256 {digest}")
    return 0


def _run(args: argparse.Namespace) -> int:
    from ..diagnosis.rig.challenge.run import OURS, diagnose_all

    folder, verdicts = Path(args.folder), Path(args.verdicts)
    with _bar(len(list(folder.glob("*/case.yaml"))), "diagnose", not args.json) as progress:
        done, failed = diagnose_all(folder, verdicts, _jobs(args), args.by or OURS, progress, args.scheduler)
    status = 1 if failed else 0
    errors = [{"case": name, "message": error} for name, error in failed]
    report = {"exit_code": status, "verdicts": str(verdicts), "diagnosed": done, "failed": errors}
    if not print_json(args, strict(report)):
        print(f"{_cases(done)} diagnosed; verdicts in {verdicts}")
    for name, error in failed:
        print(f"orchestrator: {name}: {error}", file=sys.stderr)
    return status


def _score(args: argparse.Namespace) -> int:
    from ..diagnosis.rig.challenge.score import score, score_text, write_score

    out = Path(args.verdicts)
    found = score(Path(args.folder), out)
    write_score(out / "score.json", found)
    if print_json(args, strict({"exit_code": 0, "file": str(out / "score.json"), "score": found})):
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
