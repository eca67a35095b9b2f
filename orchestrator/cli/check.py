"""The command `orchestrator check`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..base.errors import ConfigError
from .arguments import add_config, add_json, add_requests, print_json, requested_configs

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `orchestrator check`."""
    add_config(parser)
    add_requests(parser)
    parser.add_argument("-v", "--verbose", action="store_true", help="list the inputs without a connection")
    add_json(parser)


def main(args: argparse.Namespace) -> int:
    """Print what a config connects, without running it."""
    from ..simulation.run import prepare

    (config,), overrides = requested_configs(args, [args.config])
    try:
        prepared = prepare(config, overrides)
    except ConfigError as error:
        if not args.json:
            _print_notes(error.notes)
        raise
    system, run = prepared.system, prepared.config.model.run
    unconnected = {
        f"{one.name}.{name}": one.variable(name).written(one.start[name])
        for one in system.instances
        for name in sorted(one.unconnected)
    }
    report = {
        "exit_code": 0,
        "name": prepared.config.name,
        "instances": {one.name: one.fmu.description.name for one in system.instances},
        "connections": [str(one) for one in system.connections],
        "order": [system.instances[index].name for index in system.order],
        "steps": prepared.grid.steps,
        "step_size": float(prepared.grid.step_size),
        "master": run.master_name,
        "bonds": [str(bond) for bond in system.bonds],
        "unconnected": unconnected,
        "notes": list(prepared.notes),
    }
    if print_json(args, report):
        return 0
    print(f"{prepared.config.name}: {len(system.instances)} instances, {len(system.connections)} connections")
    for index in system.order:
        instance = system.instances[index]
        description = instance.fmu.description
        version = f", FMI {description.fmi_version}" if description.fmi_version else ""
        print(f"  {instance.name}: {description.name}{version}")
    print(f"order of direct feedthrough: {', '.join(system.instances[index].name for index in system.order)}")
    print(f"{prepared.grid.steps} steps of {run.step_size} to {run.stop_time}, {run.master_name}")
    for bond in system.bonds:
        print(f"power bond {bond}")
    if args.verbose:
        for port, value in unconnected.items():
            print(f"no connection: {port} = {value}")
    _print_notes(prepared.notes)
    return 0


def _print_notes(notes: Iterable[str]) -> None:
    for note in notes:
        print(f"note: {note}")
