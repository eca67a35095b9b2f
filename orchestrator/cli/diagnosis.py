"""The sub-command `diagnose`: cases to verdicts."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from ..base.errors import ConfigError, Interrupted, OrchestratorError, Problem, listed

# Of a case's diagnosis, as the progress bar counts.
_STAGES = 8
# Options of an earlier search of studies; the first one took no value.
_GONE = ("--effects", "--practice", "--seed", "--jobs")

_DESCRIPTION = """Find out from logs which unmodelled effect makes a rig differ from its model, where, how far
the gap shrinks once the effect is added, and what to run next. A case is a folder with case.yaml
and its logs, or a study.yaml. Writes diagnosis.json and report.html."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `orchestrator diagnose`."""
    parser.description = _DESCRIPTION
    parser.add_argument(
        "cases", nargs="+", type=Path, metavar="CASE", help="a case's folder, or a study.yaml"
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="write to this folder; with several cases, one folder each in it",
    )
    parser.add_argument(
        "--json", action="store_true", help="print the content of diagnosis.json, one line a case"
    )
    parser.add_argument("--effects", action="store_true", help=argparse.SUPPRESS)
    for option in _GONE[1:]:
        parser.add_argument(option, help=argparse.SUPPRESS)
    parser.add_argument("--unknown-input", action="store_true", help=argparse.SUPPRESS)  # the default by now
    parser.add_argument("--no-report", action="store_true", help="write no report.html")
    parser.add_argument("--quiet", action="store_true", help="print errors only")


def main(args: argparse.Namespace) -> int:
    """Diagnose each case.

    A case that fails is reported, and the others are done all the same.

    Returns: 0; 1 if some case failed; 2 if none of several could be read.
    Raises: ConfigError if the command is wrong, or the only case could not be read.
    """
    folders = _folders(args.cases, args.out)
    gone = [one for one in _GONE if getattr(args, one.removeprefix("--")) not in (None, False)]
    if gone:
        what, remedy = "is gone, with the search that weighed a list of effects", "Leave it out: "
        remedy += "`orchestrator diagnose STUDY` searches laws, and needs neither a list nor practice."
        raise ConfigError([Problem(one, what, remedy=remedy) for one in gone])
    refused = failed = 0
    bar = _Bar(len(args.cases) * _STAGES, shown=not args.quiet)
    for case, folder in zip(args.cases, folders, strict=True):
        bar.begin(case.name or str(case))
        try:
            data, summary = _diagnosed(args, case, folder, bar)
        except Interrupted:
            bar.close()
            raise
        except OrchestratorError as error:
            failed += 1
            refused += isinstance(error, ConfigError)
            if len(args.cases) == 1:
                bar.close()
                raise
            bar.write(f"orchestrator: {case}: {error}", sys.stderr)
            continue
        except Exception as error:  # a defect: the other cases go on
            failed += 1
            if len(args.cases) == 1 or getattr(args, "debug", False):
                bar.close()
                raise
            bar.write(f"orchestrator: {case}: {type(error).__name__}: {error}", sys.stderr)
            continue
        finally:
            bar.end(_STAGES)
        if args.json:
            bar.write(json.dumps(data, allow_nan=False, ensure_ascii=False), sys.stdout)
        elif not args.quiet:
            bar.write(summary, sys.stdout)
    bar.close()
    if refused == len(args.cases):
        return 2
    return 1 if failed else 0


def _diagnosed(args: argparse.Namespace, case: Path, folder: Path | None, bar: _Bar) -> tuple[Any, str]:
    """Diagnose one case. Returns: the content of diagnosis.json, and what a terminal shows."""
    from ..diagnosis.study.study import is_port_study

    # Cases are read before what diagnoses is imported: machine code and SciPy take seconds to load.
    if is_port_study(case):
        from ..diagnosis.study.reader import load_port_study

        study = load_port_study(case)
        from ..diagnosis.unknown_input.diagnose import diagnose_system

        found = diagnose_system(study, folder, report=not args.no_report, progress=bar.stage)
        return found.data, str(found)
    from ..diagnosis.rig.study import load_study

    load_study(case)
    from ..diagnosis.rig.diagnose import diagnose
    from ..diagnosis.rig.report_text import text

    made = diagnose(case, folder, report=not args.no_report, progress=bar.stage)
    return made.diagnosis.data_of(), text(made)


def _folders(cases: list[Path], out: Path | None) -> list[Path | None]:
    """Where each case is written to. Raises: ConfigError for cases that are not there or share a name."""
    problems = [
        Problem(str(case), "no such file or folder", "a case's folder or a study.yaml")
        for case in cases
        if not case.exists()
    ]
    names = [_name(case.resolve()) for case in cases]
    twice = sorted({name for name in names if names.count(name) > 1})
    if out is not None and twice:
        problems.append(
            Problem("", f"several cases are called {listed(twice)}", remedy="Diagnose them one by one.")
        )
    if problems:
        raise ConfigError(problems)
    if out is None:
        return [None] * len(cases)
    return [out] if len(cases) == 1 else [out / name for name in names]


def _name(case: Path) -> str:
    """What a case is called: after its folder, but for files of another name than studies usually have."""
    if case.is_dir():
        return case.name
    return case.parent.name if case.name in ("case.yaml", "study.yaml") else case.stem


class _Bar:
    """A progress bar over the stages of all cases, on a terminal."""

    def __init__(self, total: int, shown: bool) -> None:
        self._bar: Any = None
        self._stages = 0
        if shown and sys.stderr.isatty():
            from tqdm import tqdm

            self._bar = tqdm(total=total, unit="stage", file=sys.stderr, leave=False)

    def begin(self, case: str) -> None:
        self._stages = 0
        if self._bar is not None:
            self._bar.set_description(case)

    def stage(self, name: str) -> None:
        """A stage begins, and the one before it is over."""
        if self._bar is not None:
            self._bar.update(1 if self._stages else 0)
            self._bar.set_postfix_str(name)
        self._stages += 1

    def end(self, stages: int) -> None:
        """A case is over, whether all its stages were gone through or not."""
        if self._bar is not None:
            self._bar.update(stages - max(self._stages - 1, 0))

    def write(self, line: str, file: Any) -> None:
        if self._bar is not None:
            self._bar.clear()
        print(line, file=file)

    def close(self) -> None:
        if self._bar is not None:
            self._bar.close()
