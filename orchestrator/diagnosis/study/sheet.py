"""A study's file as it is read: its values with their places, and all that is wrong with them."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from ...base.errors import ConfigError, Problem
from ...base.quantities import Measure, quantity
from ...base.units import parse_unit
from ...config import compose, validation_problems

Part = TypeVar("Part", bound=BaseModel)
_SECONDS = Measure("s", parse_unit("s"))


class Sheet:
    """A study's file.

    Attributes:
        problems: what is wrong so far; reading goes on, so that all of it can be determined at once.
        unchecked: see `ConfigError`.

    Raises: ConfigError if the file is no text, no YAML, or holds no keys.
    """

    def __init__(self, file: Path) -> None:
        self.file, self.problems, self.unchecked = file, list[Problem](), list[str]()
        try:
            text = file.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            reason = error.strerror if isinstance(error, OSError) else "it is no text"
            raise ConfigError([Problem(str(file), f"cannot be read: {reason}")]) from None
        self.data, self.places, twice = compose(text, str(file))
        self.problems += [problem for _, problem in twice]
        if not isinstance(self.data, dict):
            raise ConfigError(
                [Problem(str(file), "is no study", "keys and their values, `format` among them")]
            )

    def place(self, *path: object) -> str:
        """Where a value stands: file, line and path."""
        return self.places.text(tuple(one if isinstance(one, int) else str(one) for one in path))

    def add(self, path: Sequence[object], what: str, allowed: str = "", remedy: str = "") -> None:
        """Add a problem."""
        self.problems.append(Problem(self.place(*path), what, allowed, remedy))

    def taken(self, kind: type[Part], data: Any, *path: str | int) -> tuple[Part, frozenset[str]]:
        """A part of the study as far as nothing is wrong with it; what is, is reported.

        Returns: the part, with None in place of keys that it needs and that are wrong; and the wrong keys.
        """
        try:
            return kind.model_validate(data), frozenset()
        except ValidationError as error:
            self.problems += validation_problems(error, self.places, path, kind)
            wrong = frozenset(str((*one["loc"], "")[0]) for one in error.errors())
        given = data if isinstance(data, dict) else {}
        needed = dict.fromkeys(name for name, one in kind.model_fields.items() if one.is_required())
        sound = {name: value for name, value in given.items() if name not in wrong}
        return kind.model_construct(**{**needed, **sound}), wrong

    def part(self, kind: type[Part], data: Any, *path: str | int) -> Part | None:
        """A part of the study; None if something is wrong with it."""
        found, wrong = self.taken(kind, data, *path)
        return None if wrong else found

    def size(
        self, measure: Measure, value: Any, *path: object, least: float = -math.inf, difference: bool = False
    ) -> float | None:
        """A quantity in the unit of a measure, above `least`; None if it is none.

        Args:
            difference: see `units.Quantity.exactly`.
        """
        found = quantity("", measure, value, self.place(*path), difference)
        if isinstance(found, Problem):
            self.problems.append(found)
            return None
        if not least < found < math.inf:
            self.add(path, f"got {value!r}", "a finite number" if least < 0.0 else "above 0")
            return None
        return found

    def seconds(self, value: Any, *path: object, absent: float = 0.0) -> float:
        """A time of 0 or more [s]; `absent` if none is given, or none that can be taken."""
        if value is None:
            return absent
        found = self.size(_SECONDS, value, *path)
        if found is not None and found < 0.0:
            self.add(path, f"got {value!r}", "0 s or more")
            return absent
        return absent if found is None else found

    def of_system(
        self,
        error: ConfigError,
        overrides: Mapping[int, str],
        changed: Sequence[str | int],
        otherwise: Sequence[str | int] | None,
    ) -> frozenset[int]:
        """Add the problems of a system at the lines of the study that bring them in.

        Args:
            overrides: that were made to the system, by their numbers; changed: where they stand.
            otherwise: where that stands which brings in all other problems; None: these are not reported.
        Returns: numbers of the overrides that are blamed.
        """
        blamed = set()
        if otherwise is not None:
            self.unchecked += error.unchecked
        for one in error.problems:
            marked = (key for key, text in overrides.items() if f"{one.place}:".startswith(f"--set {text}:"))
            number = next(marked, None)
            if number is not None:
                blamed.add(number)
                # An override has one line.
                rest = re.sub(r"^:\d+", "", one.place.removeprefix(f"--set {overrides[number]}"))
                self.problems.append(replace(one, place=self.place(*changed, number) + rest))
            elif otherwise is not None:
                place = ": ".join(part for part in (self.place(*otherwise), one.place) if part)
                self.problems.append(replace(one, place=place))
        return frozenset(blamed)
