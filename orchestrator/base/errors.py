"""Errors, named for who can act on them: the config's author, the FMU's author, the run's author."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any


class OrchestratorError(Exception):
    """Base of every error that this package raises on purpose."""


@dataclass(frozen=True)
class Problem:
    """One problem, with what is needed to correct it.

    Attributes:
        place: where, as `file:line: path` (parts that are unknown are left out).
        what: what is wrong, with what was got.
        allowed: what would be accepted, or the reason; empty where `what` says it all.
        remedy: what to do, as a full sentence; empty where `allowed` says it.
    """

    place: str
    what: str
    allowed: str = ""
    remedy: str = ""

    def __str__(self) -> str:
        head = f"{self.place}: {self.what}" if self.place else self.what
        if not self.allowed and not self.remedy:
            return head
        tail = self.allowed
        if self.remedy:
            joint = "\n" if "\n" in tail else ". "
            tail = f"{tail.rstrip('.')}{joint}{self.remedy}" if tail else self.remedy
        return f"{head}\n" + "\n".join(f"  {line}" for line in tail.splitlines())


# An explanation of more characters is printed for the first of several problems only.
_LONG = 240


class ConfigError(OrchestratorError):
    """A config or a system of connected FMUs that cannot be run; holds all problems found.

    Attributes:
        problems: every problem, in the order of the config.
        unchecked: what could not be checked for want of what has problems; further ones may be there.
        notes: on what is right; not part of the message.
    """

    def __init__(
        self, problems: Iterable[Problem], unchecked: Iterable[str] = (), notes: Iterable[str] = ()
    ) -> None:
        self.problems: tuple[Problem, ...] = tuple(problems)
        self.unchecked: tuple[str, ...] = tuple(dict.fromkeys(unchecked))
        self.notes: tuple[str, ...] = tuple(notes)
        lines, known = list[str](), set[str]()
        for problem in self.problems:
            head, _, tail = str(problem).partition("\n")
            lines.append(head if tail in known else f"{head}\n{tail}".rstrip("\n"))
            # A long list of what is allowed is printed once.
            if len(tail) > _LONG:
                known.add(tail)
        if self.unchecked:
            lines.append(f"Not checked because of these problems: {'; '.join(self.unchecked)}.")
        super().__init__("\n".join(lines))

    def __reduce__(self) -> tuple[Any, ...]:
        """From process to process with its problems: of an exception its message alone would be sent."""
        return type(self), (self.problems, self.unchecked, self.notes)


class FmuError(OrchestratorError):
    """An FMU that cannot be read, loaded or set up."""


# Of an FMU's log in a message.
_LOG_LINES = 10


class StepError(OrchestratorError):
    """A run that failed at a communication point.

    Attributes:
        instance: name of the instance that failed.
        time: communication point [s]; None before the first.
        status: what the FMU returned or what was found, for example "error", "discard", "not finite".
        log: the FMU's log lines, oldest first.
        what, remedy: what happened and what to do, without the rest of the message.
    """

    def __init__(
        self,
        what: str,
        *,
        instance: str,
        time: float | None,
        status: str,
        log: Sequence[str] = (),
        remedy: str = "",
    ) -> None:
        self.what = what
        self.instance = instance
        self.time = time
        self.status = status
        self.remedy = remedy
        self.log = tuple(log)
        place = instance if time is None else f"{instance} at time {time:.12g} s"
        lines = [f"{place}: {what}"]
        if remedy:
            lines.append(f"  {remedy}")
        if self.log:
            more = f", the last {_LOG_LINES} of {len(self.log)} lines" if len(self.log) > _LOG_LINES else ""
            lines.append(f"  log of the FMU{more}:")
            lines += [f"    {line}" for line in self.log[-_LOG_LINES:]]
        super().__init__("\n".join(lines))

    def __reduce__(self) -> tuple[Any, ...]:
        """From process to process with all that it knows."""
        known = {name: getattr(self, name) for name in ("instance", "time", "status", "log", "remedy")}
        return partial(type(self), **known), (self.what,)


class SimulationEnded(StepError):
    """An FMU asked to end the simulation, which is a regular end of a run.

    Attributes:
        time: when it asked [s].
    """


class Interrupted(OrchestratorError):
    """A run that was stopped from outside before its end."""


class BuildError(OrchestratorError):
    """A model that the translator refuses, or an FMU that could not be built.

    Attributes:
        problems: faults of the model, each with its place; empty for other errors.
    """

    problems: tuple[Problem, ...] = ()


def error_data(error: BaseException) -> dict[str, Any]:
    """An error for machines: its kind and message, and what it knows besides: problems, or where and when."""
    document: dict[str, Any] = {"kind": type(error).__name__, "message": str(error)}
    if isinstance(error, ConfigError) or (isinstance(error, BuildError) and error.problems):
        document["problems"] = [asdict(problem) for problem in error.problems]
    if isinstance(error, ConfigError):
        if error.unchecked:
            document["unchecked"] = list(error.unchecked)
        if error.notes:
            document["notes"] = list(error.notes)
    elif isinstance(error, StepError):
        document |= {
            "instance": error.instance,
            "time": error.time,
            "status": error.status,
            "log": list(error.log),
        }
    return document


def nearest(name: str, names: Iterable[str], prefix: str = "") -> str:
    """The sentence "Did you mean a or b?" for a mistyped name; empty if nothing is near.

    Args:
        name: what was given.
        names: what exists.
        prefix: put before each suggestion, for example "robot.".
    """
    found = close(name, names)
    return f"Did you mean {' or '.join(prefix + match for match in found)}?" if found else ""


def in_order(problems: Iterable[Problem]) -> list[Problem]:
    """Problems by the lines of their files; those of overrides, and of what has no line, first."""
    files: dict[str, int] = {}

    def order(problem: Problem) -> tuple[int, int]:
        found = re.match(r"(?!--set )([^:]*):(\d+)(:|$)", problem.place)
        return (files.setdefault(found[1], len(files) + 1), int(found[2])) if found else (0, 0)

    return sorted(problems, key=order)


def close(name: str, names: Iterable[str]) -> list[str]:
    """Which of the names that exist a mistyped one may be meant for, the likeliest first; three at most."""
    names = list(names)
    found = difflib.get_close_matches(name, names, n=3, cutoff=0.6)
    if not found:
        folded = {other.casefold(): other for other in names}
        found = [folded[name.casefold()]] if name.casefold() in folded else []
    return found


def listed(names: Iterable[str], limit: int = 20) -> str:
    """Names with commas between; "none" if there are none; the count beyond `limit`."""
    names = list(names)
    if not names:
        return "none"
    more = f" and {len(names) - limit} more" if len(names) > limit else ""
    return ", ".join(names[:limit]) + more


def needs(package: str, extra: str = "logs") -> str:
    """What to say of a package that is not installed and comes with an extra of this product."""
    return f"needs the package {package}: pip install 'orchestrator[{extra}]'"


@contextmanager
def extras_named() -> Iterator[None]:
    """Where a package is missing that comes with an extra of this product, say how to install it.

    Raises: OrchestratorError in place of the ModuleNotFoundError of such a package.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if extra := _extra_with(package):
            raise OrchestratorError(f"this {needs(package, extra)}") from error
        raise


def _extra_with(package: str) -> str:
    """The smallest extra that brings a package; empty if none does."""
    from importlib.metadata import PackageNotFoundError, requires

    try:
        requirements = requires(__package__.partition(".")[0]) or []
    except PackageNotFoundError:  # runs from a folder
        return ""
    extras: dict[str, set[str]] = {}
    for one in requirements:
        if found := re.match(r"""([\w-]+).*extra == ['"]([\w-]+)['"]""", one):
            extras.setdefault(found[2], set()).add(found[1].replace("-", "_").lower())
    having = {name: len(packages) for name, packages in extras.items() if package in packages}
    return min(having, key=having.__getitem__, default="")
