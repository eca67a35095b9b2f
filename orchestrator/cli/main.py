"""The command `orchestrator`."""

from __future__ import annotations

import sys

# Everything else is imported within functions, so that an interrupt meanwhile is one like any other.
TYPE_CHECKING = False
if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Sequence
    from typing import Any

_EXIT_CODES = """exit codes:
  0    done
  1    the run failed; what it recorded until then is kept
  2    the config or the command is wrong; nothing ran
  130  interrupted; what was recorded until then is kept
  139  an FMU crashed, and the program with it (so says a shell; 134: it aborted); with "isolate: process"
       the crash of an instance is an error of code 1 that names it
With --json an error is a JSON object on the standard output, too: {"exit_code": 2, "error": {"kind": ...,
"message": ..., "problems": [{"place", "what", "allowed", "remedy"}, ...], "unchecked": [...], "notes":
[...]}}; what could not be checked because of the problems stands under "unchecked", if anything.
"""

# Name -> help, what declares the arguments (None: there are none) and what runs it, "module:function" each:
# only those of the command that is called are imported.
COMMANDS: dict[str, tuple[str, str | None, str]] = {
    "run": ("run a system, or several and compare them", "run:add_arguments", "run:main"),
    "check": (
        "check a config and its FMUs without running them",
        "check:add_arguments",
        "check:main",
    ),
    "new": (
        "write a config to start from, of FMUs",
        "exchange:add_new_arguments",
        "exchange:new_main",
    ),
    "stability": (
        "modes of a system, and margins of its feedback loops",
        "stability:add_arguments",
        "stability:main",
    ),
    "export-results": (
        "write the results of a run, finished or not, in other formats",
        "export_results:add_arguments",
        "export_results:main",
    ),
    "export": (
        "write a system for other tools, as .fmu or .ssp",
        "exchange:add_export_arguments",
        "exchange:export_main",
    ),
    "import": (
        "make a config of another tool's .ssp or .ssd",
        "exchange:add_import_arguments",
        "exchange:import_main",
    ),
    "diagnose": (
        "find out from logs why a rig differs from its model",
        "diagnosis:add_arguments",
        "diagnosis:main",
    ),
    "reproduce": (
        "reproduce the figures and numbers of the paper, on one page",
        "reproduce:add_arguments",
        "reproduce:main",
    ),
    "schema": ("print the JSON Schema of configs", None, "listing:schema"),
    "list": (
        "list bundled systems and FMUs, masters, effects and measures",
        "arguments:add_json",
        "listing:list_known",
    ),
    "build": (
        "make an FMU from a Modelica or Python model",
        "translate:add_arguments",
        "translate:main",
    ),
    "challenge": (
        "check diagnosis blind: hide laws in a random system or in yours, search and score them",
        "challenge:add_arguments",
        "challenge:main",
    ),
    "fmu": (
        "inspect, validate, compare or bench FMUs",
        "fmu_tools.command:add_arguments",
        "fmu_tools.command:main",
    ),
    "report": (
        "make a page for the browser of what a command wrote",
        "report:add_arguments",
        "report:main",
    ),
    "sweep": (
        "run a system at many points, on all cores or a cluster",
        "campaign:add_sweep_arguments",
        "campaign:sweep_main",
    ),
    "store": (
        "look at the runs that sweeps have kept",
        "campaign:add_store_arguments",
        "campaign:store_main",
    ),
}
# Command -> the part that stands for none, and what may stand in its place.
DEFAULT_PARTS = {"challenge": ("system", ("make", "run", "score", "-h", "--help"))}


def entry_point() -> None:
    """What the console command calls."""
    _print_stack_on_crash()
    try:
        status = main()
    except KeyboardInterrupt:  # before the command began
        status = _interrupted()
    # An interrupt within code that a library compiled from text (a dataclass, say) makes `python -m` end by
    # the signal, whatever the status, unless other such code has run since.
    exec("")
    sys.exit(status)


def _print_stack_on_crash() -> None:
    """Have Python's stack printed where an FMU crashes: it shows the call.

    On Windows faults that an FMU handles by itself would be printed, too.
    """
    import faulthandler

    if sys.platform != "win32" and sys.stderr is not None:
        try:
            faulthandler.enable()
        except (OSError, ValueError):  # not a file of the system
            pass


def _interrupted() -> int:
    """Report an interrupt. Returns: the exit code."""
    print("interrupted", file=sys.stderr)
    return 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command. Returns: the exit code."""
    import traceback

    from ..base.errors import ConfigError, Interrupted, OrchestratorError, error_data, extras_named
    from .arguments import print_json

    words = _in_full(sys.argv[1:] if arguments is None else list(arguments))
    args = make_parser(words).parse_args(words)
    try:
        with extras_named():
            return function(COMMANDS[args.command][2])(args)
    except BrokenPipeError:
        return 0  # the reader of a pipe has seen enough
    except KeyboardInterrupt:
        print_json(args, {"exit_code": 130, "error": {"kind": "Interrupted", "message": "interrupted"}})
        return _interrupted()
    except OSError as error:
        print(f"orchestrator: {error}", file=sys.stderr)
        print_json(args, {"exit_code": 1, "error": error_data(error)})
        return 1
    except OrchestratorError as error:
        if getattr(args, "debug", False):
            traceback.print_exc()
        else:
            print(f"orchestrator: {error}", file=sys.stderr)
        status = 130 if isinstance(error, Interrupted) else 2 if isinstance(error, ConfigError) else 1
        print_json(args, {"exit_code": status, "error": error_data(error)})
        return status


def _in_full(words: list[str]) -> list[str]:
    """The command line with the part of a command that may be left out."""
    for k, word in enumerate(words[:-1]):
        if word in DEFAULT_PARTS:
            part, others = DEFAULT_PARTS[word]
            return words if words[k + 1] in (part, *others) else [*words[: k + 1], part, *words[k + 1 :]]
        if not word.startswith("-"):
            break
    return words


def make_parser(arguments: Sequence[str]) -> argparse.ArgumentParser:
    """The parser; of the commands, only the one that is called knows its arguments.

    Args:
        arguments: of the command line; the first that is no option is the command.
    """
    import argparse

    parser = argparse.ArgumentParser(
        prog="orchestrator",
        description="Co-simulation of connected FMUs.",
        epilog=_EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    called = next((one for one in arguments if not one.startswith("-")), None)
    for name, (text, declares, _) in COMMANDS.items():
        command = commands.add_parser(name, help=text)
        if name == called and declares is not None:
            function(declares)(command)
        command.add_argument("--debug", action="store_true", help="show tracebacks of errors")
    return parser


def function(place: str) -> Callable[..., Any]:
    """Import what "module:function" of `orchestrator.cli` names."""
    from importlib import import_module

    module, _, name = place.partition(":")
    return getattr(import_module(f"orchestrator.cli.{module}"), name)
