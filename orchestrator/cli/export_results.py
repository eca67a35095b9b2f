"""The command `orchestrator export-results`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .arguments import add_json, print_json

if TYPE_CHECKING:
    import argparse


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `orchestrator export-results`."""
    parser.add_argument("folder", metavar="DIR", help="what `run --out` wrote to, or an .arrow file in it")
    parser.add_argument("--format", default="csv", metavar="LIST", help="formats: csv, parquet, mat, h5")
    add_json(parser)


def main(args: argparse.Namespace) -> int:
    """Write recorded results in other formats."""
    from pathlib import Path

    from ..base.errors import ConfigError, Problem
    from ..results.file_formats import check_formats
    from ..results.recorders import read_results

    suffixes = check_formats(args.format.split(","))
    path = Path(args.folder)
    if not path.exists():
        raise ConfigError([Problem(str(path), "no such folder", "what `run --out` wrote to")])
    results = read_results(path)
    base = path / "results" if path.is_dir() else path
    for suffix in suffixes:
        results.write(base.with_suffix(f".{suffix}"))
    files = [f"{base.stem}.{one}" for one in suffixes]
    if print_json(args, {"exit_code": 0, "folder": str(base.parent), "files": files, "rows": len(results)}):
        return 0
    print(f"{len(results)} rows written to {base.parent}: {', '.join(files)}")
    return 0
