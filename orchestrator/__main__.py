"""The command `orchestrator`."""

from __future__ import annotations

import sys

# Everything else is imported within functions, so that an interrupt meanwhile is one like any other.
TYPE_CHECKING = False
if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

__all__ = ["entry_point", "main"]

_EXIT_CODES = """exit codes:
  0    done
  1    the run failed; what it recorded until then is kept
  2    the config or the command is wrong; nothing ran
  130  interrupted; what was recorded until then is kept
With --json an error is a JSON object on the standard output, too: {"exit_code": 2, "error": {"kind": ...,
"message": ..., "problems": [{"place", "what", "allowed", "remedy"}, ...]}}.
"""


def entry_point() -> None:
    """What the console command calls."""
    try:
        status = main()
    except KeyboardInterrupt:  # before the command began
        status = _interrupted()
    # An interrupt within code that a library compiled from text (a dataclass, say) makes `python -m` end by
    # the signal, whatever the status, unless other such code has run since.
    exec("")
    sys.exit(status)


def _interrupted() -> int:
    """Tell of an interrupt. Returns: the exit code."""
    print("interrupted", file=sys.stderr)
    return 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command. Returns: the exit code."""
    import traceback

    from . import commands
    from .errors import ConfigError, Interrupted, OrchestratorError, error_data

    parser = _parser(sys.argv[1:] if arguments is None else list(arguments))
    args = parser.parse_args(arguments)
    try:
        return args.command_function(args)
    except BrokenPipeError:
        return 0  # the reader of a pipe has seen enough
    except KeyboardInterrupt:
        commands.tell(args, {"exit_code": 130, "error": {"kind": "Interrupted", "message": "interrupted"}})
        return _interrupted()
    except OSError as error:
        print(f"orchestrator: {error}", file=sys.stderr)
        commands.tell(args, {"exit_code": 1, "error": error_data(error)})
        return 1
    except OrchestratorError as error:
        if getattr(args, "debug", False):
            traceback.print_exc()
        else:
            print(f"orchestrator: {error}", file=sys.stderr)
        status = 130 if isinstance(error, Interrupted) else 2 if isinstance(error, ConfigError) else 1
        commands.tell(args, {"exit_code": status, "error": error_data(error)})
        return status


def _parser(arguments: Sequence[str]) -> argparse.ArgumentParser:
    import argparse
    from importlib.util import find_spec

    parser = argparse.ArgumentParser(
        prog="orchestrator",
        description="Co-simulation of connected FMUs.",
        epilog=_EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    run = commands.add_parser("run", help="run a system, or several and compare them")
    _add_config(run, several=True)
    run.add_argument(
        "--out",
        metavar="DIR",
        help="write results, summary and figures to this folder; with several systems, one folder each in it",
    )
    run.add_argument(
        "--format", default="csv", metavar="LIST", help="formats besides results.arrow: csv, parquet, mat"
    )
    run.add_argument(
        "--no-halving", action="store_true", help="do not run again with half the step size for `numerics`"
    )
    run.add_argument(
        "--realtime", action="store_true", help="pace the run by the clock; run.realtime.* has the options"
    )
    run.add_argument(
        "--speed", type=float, metavar="X", help="simulated seconds per second; implies --realtime"
    )
    run.add_argument("--no-figures", action="store_true", help="draw nothing")
    run.add_argument("--quiet", action="store_true", help="print errors only")
    run.set_defaults(command_function=_run)

    check = commands.add_parser("check", help="check a config and its FMUs without running them")
    _add_config(check)
    check.set_defaults(command_function=_check)

    stability = commands.add_parser(
        "stability",
        help="margins, critical delays, characteristic roots and growth of a docking system's loop",
    )
    _add_config(stability)
    stability.add_argument("--out", metavar="DIR", help="write stability.json and figures to this folder")
    stability.set_defaults(command_function=_stability)

    export = commands.add_parser(
        "export-results", help="write the results of a run, finished or not, in other formats"
    )
    export.add_argument("folder", metavar="DIR", help="what `run --out` wrote to, or an .arrow file in it")
    export.add_argument("--format", default="csv", metavar="LIST", help="formats: csv, parquet, mat")
    export.set_defaults(command_function=_export)

    exporting = commands.add_parser("export", help="write a system for other tools, as .fmu or .ssp")
    importing = commands.add_parser("import", help="make a config of another tool's .ssp or .ssd")
    if arguments[:1] in (["export"], ["import"]):
        from .exchange import cli as exchange_cli

        _add_config(exporting)
        exchange_cli.add_export_arguments(exporting)
        exchange_cli.add_import_arguments(importing)
    exporting.set_defaults(command_function=_exchange)
    importing.set_defaults(command_function=_exchange)

    diagnose = commands.add_parser("diagnose", help="tell from logs why a rig differs from its model")
    if arguments[:1] == ["diagnose"]:
        from .diagnosis import cli as diagnosis_cli

        diagnosis_cli.add_arguments(diagnose)
    diagnose.set_defaults(command_function=_diagnose)

    reproduction = commands.add_parser(
        "reproduce", help="make the source's figures and numbers again, on one page"
    )
    if arguments[:1] == ["reproduce"]:
        from .docking.reproduction import command as reproducing

        reproducing.add_arguments(reproduction)
    reproduction.set_defaults(command_function=_reproduce)

    schema = commands.add_parser("schema", help="print the JSON Schema of configs")
    schema.set_defaults(command_function=_schema)

    listing = commands.add_parser("list", help="list bundled systems and FMUs, masters, effects and measures")
    listing.set_defaults(command_function=_list)

    build = commands.add_parser("build", help="make an FMU from a Modelica or Python model")
    # The translator is imported only where it is asked for.
    if arguments[:1] == ["build"] and find_spec("orchestrator.translate.cli") is not None:
        from .translate import cli

        cli.add_arguments(build)
    build.set_defaults(command_function=_build)

    challenge = commands.add_parser(
        "challenge", help="check diagnosis blind: make cases with hidden effects, diagnose and score them"
    )
    if arguments[:1] == ["challenge"]:
        from .diagnosis.challenge import cli as challenge_cli

        challenge_cli.add_arguments(challenge)
    challenge.set_defaults(command_function=_challenge)

    fmu = commands.add_parser("fmu", help="inspect, validate, compare or bench FMUs")
    if arguments[:1] == ["fmu"]:
        from .fmu_tools import cli as fmu_cli

        fmu_cli.add_arguments(fmu)
    fmu.set_defaults(command_function=_fmu)

    report = commands.add_parser("report", help="make a page for the browser of what a command wrote")
    if arguments[:1] == ["report"]:
        from .report import cli as report_cli

        report_cli.add_arguments(report)
    report.set_defaults(command_function=_report)

    for command in (run, check, stability, export, reproduction, listing):
        command.add_argument("--json", action="store_true", help="print JSON, one line a result, and no text")

    sweep = commands.add_parser("sweep", help="run a system at many points, on all cores or a cluster")
    store = commands.add_parser("store", help="look at the runs that sweeps have kept")
    if arguments[:1] in (["sweep"], ["store"]):
        from .campaign import cli as campaign_cli

        campaign_cli.add_sweep_arguments(sweep)
        campaign_cli.add_store_arguments(store)
    sweep.set_defaults(command_function=_sweep)
    store.set_defaults(command_function=_store)

    for command in commands.choices.values():
        command.add_argument("--debug", action="store_true", help="show tracebacks of errors")
    return parser


def _add_config(parser: argparse.ArgumentParser, several: bool = False) -> None:
    parser.add_argument(
        "config",
        nargs="+" if several else None,
        metavar="NAME|CONFIG",
        help="a bundled system, a YAML file, or a .ssp or .ssd file",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="PATH=VALUE",
        dest="overrides",
        help='change a value, for example robot.tau_m="6 ms" or run.step_size="50 us"; may be given again',
    )


def _run(args: argparse.Namespace) -> int:
    from . import commands

    return commands.run(args)


def _check(args: argparse.Namespace) -> int:
    from . import commands

    return commands.check(args)


def _export(args: argparse.Namespace) -> int:
    from . import commands

    return commands.export_results(args)


def _schema(args: argparse.Namespace) -> int:
    from . import commands

    return commands.schema(args)


def _list(args: argparse.Namespace) -> int:
    from . import commands

    return commands.list_known(args)


def _stability(args: argparse.Namespace) -> int:
    from .frequency import report

    return report.main(args)


def _exchange(args: argparse.Namespace) -> int:
    from .exchange import cli

    return (cli.export_main if args.command == "export" else cli.import_main)(args)


def _diagnose(args: argparse.Namespace) -> int:
    from .diagnosis import cli

    return cli.main(args)


def _reproduce(args: argparse.Namespace) -> int:
    from .docking.reproduction import command

    return command.main(args)


def _build(args: argparse.Namespace) -> int:
    from .translate import cli

    return cli.main(args) or 0


def _challenge(args: argparse.Namespace) -> int:
    from .diagnosis.challenge import cli

    return cli.main(args)


def _fmu(args: argparse.Namespace) -> int:
    from .fmu_tools import cli

    return cli.main(args)


def _sweep(args: argparse.Namespace) -> int:
    from .campaign import cli

    return cli.sweep_main(args)


def _store(args: argparse.Namespace) -> int:
    from .campaign import cli

    return cli.store_main(args)


def _report(args: argparse.Namespace) -> int:
    from .report import cli

    return cli.main(args)


if __name__ == "__main__":
    entry_point()
