"""Record of the cases to which a folder's verdicts belong, since cases of all challenges have equal names."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path

from ....base.atomic_files import write_text
from ....base.digests import digest_of, file_digest
from ....base.errors import ConfigError, Problem, listed
from ....simulation.run_folder import folder_at
from ..verdict import NAME

RECORD = "cases.json"


def case_digest(case: Path) -> str:
    """Digest of a case: of case.yaml and the logs beside it."""
    files = [case / "case.yaml", *sorted(case.glob("*.csv.gz"))]
    return digest_of("".join(f"{one.name} {file_digest(one)}\n" for one in files).encode())


def check_record(cases: Iterable[Path], verdicts: Path) -> None:
    """Reject verdicts of other cases. Verdicts written by hand have no record and are accepted.

    Args:
        cases: folders of the cases; verdicts: holds <case>/diagnosis.json.
    Raises: ConfigError.
    """
    known = _recorded(verdicts)
    there = [case for case in cases if case.name in known and (verdicts / case.name / NAME).is_file()]
    others = [case for case in there if case_digest(case) != known[case.name]]
    if others:
        what = f"holds verdicts of other cases of these names than {others[0].parent} does: "
        allowed = f"the cases that {RECORD} holds the digests of"
        remedy = "Name another folder by --verdicts, one for each challenge."
        names = listed([case.name for case in others], 5)
        raise ConfigError([Problem(str(verdicts), what + names, allowed, remedy)])


def note_cases(cases: Iterable[Path], verdicts: Path) -> None:
    """Write the digests of cases beside their verdicts."""
    noted = _recorded(verdicts) | {case.name: case_digest(case) for case in cases}
    folder_at(verdicts)
    write_text(verdicts / RECORD, json.dumps(dict(sorted(noted.items())), indent=1) + "\n")


def _recorded(verdicts: Path) -> Mapping[str, str]:
    """Digests of cases by name; empty without a record. Raises: ConfigError if it cannot be read."""
    path = verdicts / RECORD
    try:
        return dict(json.loads(path.read_text(encoding="utf-8"))) if path.is_file() else {}
    except (ValueError, TypeError) as error:
        allowed = "what `orchestrator challenge run` wrote"
        remedy = "Have the cases diagnosed again, with another folder as --verdicts."
        raise ConfigError([Problem(str(path), f"is no record of cases: {error}", allowed, remedy)]) from None
