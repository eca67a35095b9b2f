"""What ran where: run everything in every client that is installed, and write the table of docs/exchange.md.

    python -m tests.clients.matrix [--show]

Nothing in the table is typed by hand. Clients that are absent stop the command: the table would lose them.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from .limits import LIMITS, limit_of
from .masters import CLIENTS
from .subjects import GROUPS, groups
from .trial import ROOT, TOLERANCE, Outcome, outcomes

__all__ = ["DOCUMENT", "cell", "collect", "main", "rows_of", "table"]

DOCUMENT = ROOT / "docs" / "exchange.md"
BEGIN, END = "<!-- python -m tests.clients.matrix writes from here -->", "<!-- to here -->"

# By group and name of the job.
Found = dict[str, dict[str, Outcome]]


def collect(client: str, folder: Path) -> Found:
    """What a client makes of everything; systems as SSP only where it reads them."""
    made = CLIENTS[client]
    asked = dict(groups(folder, made.master))
    if not made.reads:
        asked[GROUPS[5]] = []
    keyed = [(f"{group}/{job.name}", job, results) for group, jobs in asked.items() for job, results in jobs]
    answers = outcomes(client, [(job, results) for _, job, results in keyed])
    found: Found = {group: {} for group in asked}
    for (key, job, _), outcome in zip(keyed, answers, strict=True):
        found[key.partition("/")[0]][job.name] = outcome
    return found


def cell(found: Mapping[str, Outcome]) -> str:
    """How many of a group agree."""
    if not found:
        return "not tried"
    good = sum(outcome.agrees for outcome in found.values())
    return f"all {good}" if good == len(found) else f"{good} of {len(found)}"


def table(all_found: Mapping[str, Found]) -> list[str]:
    """Lines of the table."""
    heads = [f"{CLIENTS[client].name} {CLIENTS[client].version()}" for client in all_found]
    lines = [f"| | {' | '.join(heads)} |", "|---" * (len(heads) + 1) + "|"]
    for group in GROUPS:
        lines.append(f"| {group} | {' | '.join(cell(found[group]) for found in all_found.values())} |")
    return lines


def rows_of(text: str, client: str) -> dict[str, str] | None:
    """What a document's table says of a client, by group; None if it does not show this version of it."""
    begin, end = text.index(BEGIN), text.index(END)
    rows = [
        [one.strip() for one in line.strip("|").split("|")]
        for line in text[begin:end].splitlines()
        if line[:1] == "|"
    ]
    head = f"{CLIENTS[client].name} {CLIENTS[client].version()}"
    if not rows or head not in rows[0]:
        return None
    column = rows[0].index(head)
    return {row[0]: row[column] for row in rows[2:]}


def remarks(all_found: Mapping[str, Found]) -> list[str]:
    """What does not run, and why."""
    lines = []
    for client, found in all_found.items():
        for limit in (one for one in LIMITS if one.client == client):
            names = {
                name: None
                for group in found.values()
                for name, outcome in group.items()
                if limit_of(client, name, outcome) is limit
            }
            if names:
                lines.append(f"- {CLIENTS[client].name} {limit.meaning}: {_listed(names)}.")
    return lines


def _listed(names: Iterable[str]) -> str:
    return "; ".join(names)


def written(all_found: Mapping[str, Found]) -> str:
    """What stands between the marks."""
    return "\n".join([BEGIN, "", *table(all_found), "", *remarks(all_found), "", END])


def main(arguments: Sequence[str] | None = None) -> None:
    """Run and write, or show."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--show", action="store_true", help="print every outcome, write nothing")
    parser.add_argument("clients", nargs="*", help="with --show: those only")
    options = parser.parse_args(arguments)
    chosen = options.clients if options.show and options.clients else list(CLIENTS)
    for client in chosen:
        if why := CLIENTS[client].absent():
            raise SystemExit(why)
    with tempfile.TemporaryDirectory() as folder:
        all_found = {client: collect(client, Path(folder)) for client in chosen}
    if options.show:
        _show(all_found)
    text = written(all_found)
    unknown = [
        f"{client}: {name}: {outcome.reason or f'deviates by {outcome.deviation:.2g} in {outcome.worst}'}"
        for client, found in all_found.items()
        for group in found.values()
        for name, outcome in group.items()
        if not outcome.agrees and limit_of(client, name, outcome) is None
    ]
    if options.show:
        print(text)
    print("\n".join(unknown))
    if not options.show:
        if unknown:
            raise SystemExit(f"nothing written: the above is beyond {TOLERANCE:g} and no known limit")
        old = DOCUMENT.read_text(encoding="utf-8")
        new = old[: old.index(BEGIN)] + text + old[old.index(END) + len(END) :]
        DOCUMENT.write_text(new, encoding="utf-8")


def _show(all_found: Mapping[str, Found]) -> None:
    for client, found in all_found.items():
        for group in found.values():
            for name, outcome in group.items():
                print(f"{client:26} {name:40} {outcome.deviation} {outcome.worst} {outcome.reason[:200]}")


if __name__ == "__main__":
    main()
