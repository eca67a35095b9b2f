"""The sub-command `fmu`: inspect, validate, compare and bench FMUs."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ...base.errors import ConfigError, FmuError, Problem, nearest
from ...fmi.bundled import find_fmu, fmu_names

_EXIT_CODES = """exit codes:
  0    nothing to complain of
  1    validate: findings of level error; compare: not interchangeable, or beyond --tolerance
  2    an FMU cannot be read, or the command is wrong
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `orchestrator fmu`."""
    parser.epilog = _EXIT_CODES
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    tools = parser.add_subparsers(dest="tool", required=True, metavar="TOOL")
    inspecting = tools.add_parser("inspect", help="what is in an FMU, without running it")
    validating = tools.add_parser("validate", help="what is wrong with an FMU and how it behaves")
    comparing = tools.add_parser("compare", help="how two FMUs, versions or forms of one differ")
    benching = tools.add_parser("bench", help="what a step and an instance cost; of two FMUs, the ratio")
    for tool, several in ((inspecting, True), (validating, True), (comparing, False), (benching, True)):
        if several:
            tool.add_argument("fmus", nargs="+", metavar="FILE|NAME", help="an .fmu file, or a bundled one")
        tool.add_argument("--json", action="store_true", help="print JSON, one line an FMU")
        tool.add_argument("--debug", action="store_true", help="show tracebacks of errors")
    comparing.add_argument("fmus", nargs=2, metavar="FILE|NAME", help="two .fmu files, or bundled ones")
    for tool in (validating, comparing, benching):
        tool.add_argument("--step-size", type=float, metavar="SECONDS", help="instead of the FMU's own [s]")
        tool.add_argument("--seed", type=int, default=1, help="of the inputs (default: 1)")
    for tool, steps in ((validating, 50), (comparing, 500)):
        tool.add_argument("--steps", type=int, default=steps, help=f"of a trajectory (default: {steps})")
    validating.add_argument(
        "--interface", choices=["co-simulation", "model-exchange"], help="the one to try, if there are both"
    )
    validating.add_argument(
        "--time-limit",
        type=float,
        default=60.0,
        metavar="SECONDS",
        help="of each check of behaviour (default: 60)",
    )
    comparing.add_argument(
        "--tolerance",
        type=float,
        metavar="PART",
        help="exit with 1 if an output differs by more than this part of its largest value",
    )
    benching.add_argument(
        "--rounds", type=int, default=9, help="repeats; the median is reported (default: 9)"
    )


def main(args: argparse.Namespace) -> int:
    """Process every FMU; report those that cannot be read, and continue with the others.

    Returns: see the help.
    Raises: ConfigError if the command is wrong.
    """
    _check(args)
    paths = [_path(name) for name in args.fmus]
    if args.tool == "compare":
        return _guarded(args, lambda: _compare(paths, args))
    if args.tool == "bench":
        return _guarded(args, lambda: _bench(paths, args))
    tool = _inspect if args.tool == "inspect" else _validate
    return max(_guarded(args, lambda path=path: tool(path, args)) for path in paths)


def _check(args: argparse.Namespace) -> None:
    problems = []
    for name, least in (("steps", 8), ("rounds", 3), ("step_size", 0.0), ("time_limit", 0.0), ("seed", 0)):
        value = getattr(args, name, None)
        if value is None:
            continue
        option = "--" + name.replace("_", "-")
        if least and not value >= least:
            problems.append(Problem("", f"{option} is {value!r}", f"it must be at least {least}"))
        elif name == "seed" and value < 0:
            problems.append(Problem("", f"{option} is {value!r}", "it must not be negative"))
        elif not least and name != "seed" and not 0.0 < value < float("inf"):
            problems.append(Problem("", f"{option} is {value!r}", "it must be above 0 s"))
    if problems:
        raise ConfigError(problems)


def _path(name: str) -> Path:
    path = Path(name)
    if path.is_file():
        return path
    bundled = find_fmu(name)
    if bundled is not None:
        return bundled
    hint = nearest(name, fmu_names())
    what = f"there is no file {name!r}, and no bundled FMU of that name"
    raise ConfigError([Problem("", what, remedy=hint or "`orchestrator list` names the bundled ones.")])


def _guarded(args: argparse.Namespace, tool: Callable[[], int]) -> int:
    try:
        return tool()
    except FmuError as error:
        if args.debug:
            raise
        if args.json:
            print(json.dumps({"error": str(error)}))
        print(f"orchestrator: {error}", file=sys.stderr)
        return 2


def _inspect(path: Path, args: argparse.Namespace) -> int:
    from .contents import inspect_fmu
    from .text import inspection_text

    found = inspect_fmu(path)
    print(_line(found) if args.json else inspection_text(found))
    return 0


def _line(value: Any) -> str:
    return json.dumps(_plain(value), allow_nan=False)


def _plain(value: Any) -> Any:
    """What is neither a number nor a text becomes one; JSON has no NaN and no infinity: they become texts."""
    if isinstance(value, dict):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [_plain(one) for one in value]
    if isinstance(value, float) and not math.isfinite(value):
        return repr(value)
    if value is None or isinstance(value, bool | int | float):
        return value
    return str(value)


def _validate(path: Path, args: argparse.Namespace) -> int:
    from ...fmi import Interface
    from .text import finding_line, verdicts_line
    from .trial import Conditions
    from .validate import has_errors, validate_fmu

    if not args.json:
        print(f"{path}:")
    found = validate_fmu(
        path,
        Conditions(args.steps, args.step_size, args.seed),
        interface=Interface(args.interface) if args.interface else None,
        time_limit=args.time_limit,
        seen=lambda finding: None if args.json else print(finding_line(finding), flush=True),
    )
    if args.json:
        print(_line({"file": str(path), "findings": [one.as_dict() for one in found]}))
    else:
        print(verdicts_line(found))
    return int(has_errors(found))


def _compare(paths: list[Path], args: argparse.Namespace) -> int:
    from .comparison import compare_fmus, comparison_text
    from .trial import Conditions

    found = compare_fmus(*paths, Conditions(args.steps, args.step_size, args.seed))
    beyond = args.tolerance is not None and (
        found.conditions is None or any(not one.relative <= args.tolerance for one in found.differences)
    )
    if args.json:
        print(_line({"files": [str(path) for path in paths], **found.as_dict()}))
    else:
        print(comparison_text(found, paths))
    return int(found.interface_differs or beyond)


def _bench(paths: list[Path], args: argparse.Namespace) -> int:
    from .bench import bench_fmus, bench_text
    from .trial import Conditions

    found = bench_fmus(paths, Conditions(step_size=args.step_size, seed=args.seed), args.rounds)
    print(_line(found) if args.json else bench_text(found))
    return 0
