"""Seals the truth of a challenge, and opens it for scoring alone, with a ledger of every opening.

The seal keeps the truth from being read by accident, and shows which verdicts were there before it was first
opened; it is no defence against someone who means to look, who could as well make the cases again if the seed
is known.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import os
import zlib
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from ....base.digests import digest_of
from ....base.errors import ConfigError, Problem

SEALED = "truth.sealed"
LEDGER = "openings.json"
_FORMAT = b"gap-truth/1"


def seal_truth(folder: Path, truth: Mapping[str, Any], key: bytes) -> str:
    """Write the truth of all cases, compressed, with a keyed digest.

    Args:
        key: 32 bytes that nobody guesses: without them the digest of a short truth could be tried out.
    Returns: the digest of the file, to be printed and kept.
    """
    body = zlib.compress(json.dumps(truth, sort_keys=True).encode(), 9)
    mark = hmac.new(key, body, hashlib.sha256).hexdigest().encode()
    data = b"\n".join([_FORMAT, mark, key.hex().encode(), body.hex().encode(), b""])
    (folder / SEALED).write_bytes(data)
    return digest_of(data)


def truth_digest(folder: Path) -> str:
    """Digest of the sealed file, without opening it.

    Raises: ConfigError if there is none.
    """
    return digest_of(_sealed(folder))


def open_truth(folder: Path) -> dict[str, Any]:
    """Hidden effects of each case. Only scoring calls this, after the verdicts are in the ledger.

    Raises: ConfigError if the file is missing, damaged or changed.
    """
    data = _sealed(folder)
    place = str(folder / SEALED)
    parts = data.split(b"\n")
    if len(parts) != 5 or parts[0] != _FORMAT:
        raise ConfigError([Problem(place, "is no sealed truth", f"a file of format {_FORMAT.decode()}")])
    try:
        key, body = bytes.fromhex(parts[2].decode()), bytes.fromhex(parts[3].decode())
    except ValueError:
        raise ConfigError([Problem(place, "is damaged", remedy="Make the challenge again.")]) from None
    if not hmac.compare_digest(hmac.new(key, body, hashlib.sha256).hexdigest().encode(), parts[1]):
        raise ConfigError([Problem(place, "does not fit its seal", remedy="Make the challenge again.")])
    return json.loads(zlib.decompress(body))


def note_opening(folder: Path, verdicts: Mapping[str, str]) -> bool:
    """Write the digests of verdicts into the ledger before the truth is opened.

    Args:
        verdicts: digest of each case's verdict.
    Returns: whether the verdicts are blind: given when the truth had not been opened yet.
    """
    path = folder / LEDGER
    entries = json.loads(path.read_text(encoding="utf-8")) if path.exists() else []
    entry = {"truth": truth_digest(folder), "verdicts": dict(sorted(verdicts.items()))}
    for earlier in entries:
        if {name: earlier[name] for name in entry} == entry:
            return earlier["blind"]
    blind = not entries
    entries.append({**entry, "blind": blind, "at": datetime.now(UTC).isoformat(timespec="seconds")})
    waiting = path.with_suffix(".part")
    waiting.write_text(json.dumps(entries, indent=1) + "\n", encoding="utf-8")
    os.replace(waiting, path)
    return blind


def _sealed(folder: Path) -> bytes:
    path = folder / SEALED
    if not path.is_file():
        raise ConfigError(
            [Problem(str(folder), f"holds no {SEALED}", remedy="Make one by `orchestrator challenge make`.")]
        )
    return path.read_bytes()
