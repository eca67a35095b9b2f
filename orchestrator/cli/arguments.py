"""Arguments and output that several commands share."""

from __future__ import annotations

import json
import os
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import argparse
    from collections.abc import Mapping, Sequence

    from ..config import Config


def one_matrix_thread() -> None:
    """Let numpy, if it is not loaded yet, use one thread.

    With many small matrices threads wait for one another; on a busy machine that takes 15 times as long.
    """
    if "numpy" not in sys.modules:
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def add_config(parser: argparse.ArgumentParser, several: bool = False) -> None:
    """Declare the config that a command takes, or several, and overrides of it."""
    parser.add_argument(
        "config",
        nargs="+" if several else None,
        metavar="NAME|CONFIG",
        help="a bundled system, a YAML file, an .fmu file, or a .ssp or .ssd file",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="PATH=VALUE",
        dest="overrides",
        help='change a value, for example robot.tau_m="6 ms" or run.step_size="50 us", of a single FMU '
        "start.k=3; may be given again",
    )


def add_requests(parser: argparse.ArgumentParser) -> None:
    """Declare what a run is asked for besides its config; see `requested_configs`."""
    parser.add_argument(
        "--input",
        metavar="CSV",
        help="a file of signals over time: time [s], and a column for each input that it feeds, as force [N]",
    )
    for key in ("stop-time", "step-size"):
        parser.add_argument(
            f"--{key}", metavar="TIME", help=f"short for --set run.{key.replace('-', '_')}=..."
        )
    parser.add_argument(
        "--record",
        action="append",
        default=[],
        metavar="PATTERN",
        help='record further variables, for example "der(*)" or "robot.*"; may be given again',
    )


def add_json(parser: argparse.ArgumentParser) -> None:
    """Declare `--json`; see `print_json`."""
    parser.add_argument("--json", action="store_true", help="print JSON, one line a result, and no text")


def print_json(args: argparse.Namespace, data: Mapping[str, Any]) -> bool:
    """Print a JSON object in one line if `--json` is given. Returns: whether it is."""
    if not getattr(args, "json", False):
        return False
    print(json.dumps(data, allow_nan=False, ensure_ascii=False, default=str))
    return True


def requested_configs(
    args: argparse.Namespace, configs: Sequence[str], overrides: Sequence[str] = ()
) -> tuple[Sequence[str | Config], list[str]]:
    """The configs that a command names, and the overrides that are still to be made."""
    overrides = [*args.overrides, *overrides]
    for key, value in (("stop_time", args.stop_time), ("step_size", args.step_size)):
        if value is not None:
            plain = value.strip().lstrip("+-").replace(".", "", 1).replace("e", "", 1).replace("-", "", 1)
            overrides.append(f"run.{key}={value} s" if plain.isdigit() else f"run.{key}={value}")
    if not args.input and not args.record:
        return configs, overrides
    from ..system.command_line_signals import requested

    return [requested(one, overrides, inputs=args.input, record=args.record) for one in configs], []
