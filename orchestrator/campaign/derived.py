"""Quantities of a run as expressions over its signals, summary numbers and parameters.

    max(abs(contact.force))                     of a signal, over all recorded instants
    rms(robot.position - satellite.position)    arithmetic of signals within a reducer
    at(satellite.position, "0.5 s")             on the line between two recorded instants
    contacts[1].rebound_velocity_ratio / contacts[0].rebound_velocity_ratio
    peak / robot.tau_m                          summary numbers and parameters stand outside reducers

Nothing but these forms is read: an expression comes with a study, and a study may come from elsewhere.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from ..base.errors import ConfigError, Problem, listed, nearest
from ..base.units import UnitError, parse_quantity, parse_unit
from ..results.recorders import Results

_OPERATORS: dict[type, Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.UAdd: operator.pos,
    ast.USub: operator.neg,
}
_ELEMENTWISE: dict[str, Callable[..., Any]] = {
    "abs": np.abs,
    "sqrt": np.sqrt,
    "sign": np.sign,
    "exp": np.exp,
    "log": np.log,
}


def _integral(values: np.ndarray, time: np.ndarray) -> float:
    return float(np.trapezoid(values, time))


# Of values over time, shape (n,) each.
_REDUCERS: dict[str, Callable[[np.ndarray, np.ndarray], float]] = {
    "max": lambda values, time: float(values.max()),
    "min": lambda values, time: float(values.min()),
    "mean": lambda values, time: float(values.mean()),
    "std": lambda values, time: float(values.std()),
    "rms": lambda values, time: float(np.sqrt(np.mean(np.square(values)))),
    "first": lambda values, time: float(values[0]),
    "final": lambda values, time: float(values[-1]),
    "integral": _integral,
    "time_of_max": lambda values, time: float(time[int(np.argmax(values))]),
    "time_of_min": lambda values, time: float(time[int(np.argmin(values))]),
}
_FORMS = "numbers, + - * / **, names, " + ", ".join((*_REDUCERS, "at", *_ELEMENTWISE))
_LONGEST, _DEEPEST = 2000, 50


class _Wrong(Exception):
    pass


class Derived:
    """One quantity.

    Attributes:
        name: of it.
        text: as the study has it.
        signals: names of the signals that it reads.
        numbers: names of summary numbers and parameters that it reads.
        instants: at which it reads signals [s].
    """

    def __init__(self, name: str, text: str) -> None:
        """Raises: ValueError, saying what is wrong with the text."""
        self.name, self.text = name, text
        self.signals: dict[str, None] = {}
        self.numbers: dict[str, None] = {}
        self.instants: dict[float, None] = {}
        if len(text) > _LONGEST:
            raise ValueError(f"longer than {_LONGEST} characters")
        try:
            self._tree = ast.parse(text.strip(), mode="eval").body
            self._walk(self._tree, False, 0)
        except (SyntaxError, MemoryError, RecursionError) as error:
            raise ValueError(f"cannot be read ({getattr(error, 'msg', error)})") from None
        except _Wrong as error:
            raise ValueError(str(error)) from None

    def value(self, results: Results, measured: Mapping[str, Any]) -> float | None:
        """The quantity of a run; None where something that it needs is not there, or it is no number."""
        try:
            with np.errstate(all="ignore"):
                value = float(self._of(self._tree, results, measured, False))
        except (_Wrong, ZeroDivisionError, OverflowError, TypeError, IndexError, ValueError):
            return None
        return value if math.isfinite(value) else None

    def _walk(self, node: ast.AST, within: bool, depth: int) -> None:
        """Check an expression; `within` says whether names are signals."""
        if depth > _DEEPEST:
            raise _Wrong("too deep")
        if isinstance(node, ast.BinOp | ast.UnaryOp):
            if type(node.op) not in _OPERATORS:
                raise _Wrong(f"{type(node.op).__name__} is not among its operations; it may hold {_FORMS}")
            parts = [node.left, node.right] if isinstance(node, ast.BinOp) else [node.operand]
            if isinstance(node.op, ast.Pow) and not _small(node.right):  # type: ignore[union-attr]
                raise _Wrong("an exponent must be a number from -16 to 16")
            for part in parts:
                self._walk(part, within, depth + 1)
        elif isinstance(node, ast.Call):
            self._walk_call(node, within, depth)
        elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
            if not abs(node.value) <= 1e300:
                raise _Wrong(f"{node.value!r} is too large")
        else:
            name = _name(node)
            if name is None:
                raise _Wrong(f"{ast.unparse(node)!r} is none of its forms; it may hold {_FORMS}")
            if name == "time" and within:
                return
            (self.signals if within else self.numbers)[name] = None

    def _walk_call(self, node: ast.Call, within: bool, depth: int) -> None:
        name = node.func.id if isinstance(node.func, ast.Name) else ""
        known = (*_REDUCERS, "at", *_ELEMENTWISE)
        if name not in known:
            what = ast.unparse(node.func)
            raise _Wrong(f"no function {what!r}; there are {listed(known)}. {nearest(what, known)}".strip())
        count = 2 if name == "at" else 1
        if node.keywords or len(node.args) != count:
            raise _Wrong(f"{name} takes {count} argument{'s' if count > 1 else ''}")
        if name in _ELEMENTWISE:
            self._walk(node.args[0], within, depth + 1)
            return
        if within:
            raise _Wrong(f"{name} stands within another reducer")
        if name == "at":
            self.instants[_seconds(node.args[1])] = None
        self._walk(node.args[0], True, depth + 1)

    def _of(self, node: ast.AST, results: Results, measured: Mapping[str, Any], within: bool) -> Any:
        if isinstance(node, ast.Constant) and not isinstance(node.value, str):
            return float(node.value)  # type: ignore[arg-type]
        if isinstance(node, ast.BinOp):
            left = self._of(node.left, results, measured, within)
            return _OPERATORS[type(node.op)](left, self._of(node.right, results, measured, within))
        if isinstance(node, ast.UnaryOp):
            return _OPERATORS[type(node.op)](self._of(node.operand, results, measured, within))
        if isinstance(node, ast.Call):
            name = node.func.id  # type: ignore[attr-defined]
            if name in _ELEMENTWISE:
                return _ELEMENTWISE[name](self._of(node.args[0], results, measured, within))
            values = self._of(node.args[0], results, measured, True)
            values = np.broadcast_to(np.asarray(values, float), results.time.shape)
            if name != "at":
                return _REDUCERS[name](values, results.time)
            instant = _seconds(node.args[1])
            if not results.time[0] <= instant <= results.time[-1]:
                raise _Wrong("outside the run")
            return float(np.interp(instant, results.time, values))
        wanted = _name(node) or ""
        if within:
            return results.time if wanted == "time" else np.asarray(results.signals[wanted], float)
        found = lookup(measured, wanted)
        if found is None:
            found = results.parameters.get(wanted)
        if isinstance(found, bool) or not isinstance(found, int | float):
            raise _Wrong(f"no number {wanted}")
        return float(found)


def _small(node: ast.AST) -> bool:
    sign = 1
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        node, sign = node.operand, -1
    return (
        isinstance(node, ast.Constant) and type(node.value) in (int, float) and -16 <= sign * node.value <= 16
    )


def _name(node: ast.AST) -> str | None:
    """A name with dots and indices, as it is written: contacts[0].cor, arm.q[1], or in quotes."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute):
        inner = _name(node.value)
        return None if inner is None else f"{inner}.{node.attr}"
    if isinstance(node, ast.Subscript):
        inner = _name(node.value)
        index = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        if inner is None or not all(
            isinstance(one, ast.Constant) and type(one.value) is int for one in index
        ):
            return None
        return f"{inner}[{','.join(str(one.value) for one in index)}]"  # type: ignore[attr-defined]
    return None


def _seconds(node: ast.AST) -> float:
    text = node.value if isinstance(node, ast.Constant) else None
    try:
        if not isinstance(text, str):
            raise UnitError(f"{ast.unparse(node)} is no time")
        return parse_quantity(text).to(parse_unit("s"))
    except UnitError as error:
        raise _Wrong(f'{error}; a time is written as "0.5 s", in quotes') from None


def lookup(measured: Any, path: str) -> Any:
    """What stands at a path, such as contacts[0].cor, in a measure's numbers; None if nothing does."""
    for part in path.replace("]", "").replace("[", ".").split("."):
        if isinstance(measured, Mapping):
            measured = measured.get(part)
        elif isinstance(measured, Sequence) and not isinstance(measured, str) and part.isdecimal():
            measured = measured[int(part)] if int(part) < len(measured) else None
        else:
            return None
    return measured


def parse_derived(
    texts: Mapping[str, str], recorded: Sequence[str] | None, place: Callable[[str], str]
) -> tuple[Derived, ...]:
    """Quantities by name.

    Args:
        recorded: names of the signals that a run records; None: not known, and not checked.
        place: where each was written.
    Raises: ConfigError with all that is wrong with them.
    """
    made, problems = [], []
    for name, text in texts.items():
        try:
            one = Derived(name, text)
        except ValueError as error:
            problems.append(Problem(place(name), f"{name}: {text!r}: {error}"))
            continue
        for signal in one.signals if recorded is not None else ():
            if signal not in recorded:
                allowed = f"recorded are: {listed(recorded)}"
                remedy = nearest(signal, recorded) or "Name it in run.record."
                problems.append(Problem(place(name), f"{name}: no signal {signal!r}", allowed, remedy))
        made.append(one)
    if problems:
        raise ConfigError(problems)
    return tuple(made)


def unknown_numbers(
    derived: Sequence[Derived],
    parameters: Sequence[str],
    recorded: Sequence[str],
    instances: Sequence[str],
    measured: bool,
    place: Callable[[str], str],
) -> list[Problem]:
    """Problems of names outside reducers that no run has a number for.

    What measures find is known after a run only: of those names only those of instances are checked.

    Args:
        parameters: and start values, as instance.variable, that are numbers.
        recorded: names of the signals that a run records.
        instances: by name.
        measured: whether the system has measures.
        place: where each quantity was written.
    """
    problems = []
    for one in derived:
        for name in one.numbers:
            head = name.partition(".")[0]
            if name in parameters or (measured and head not in instances):
                continue
            what = f"{one.name}: no number {name!r}"
            if name in recorded:
                allowed = (
                    "it is a signal: outside max, final and so on stand parameters and numbers of the summary"
                )
                problems.append(Problem(place(one.name), what, allowed, f"Write final({name})."))
                continue
            if head in instances:
                own = [other.removeprefix(f"{head}.") for other in parameters if other.startswith(f"{head}.")]
                allowed = f"parameters of {head}: {listed(own)}"
                remedy = nearest(name.removeprefix(f"{head}."), own, f"{head}.")
            else:
                allowed = f"the system has no measures; parameters: {listed(parameters)}"
                remedy = nearest(name, parameters)
            problems.append(Problem(place(one.name), what, allowed, remedy))
    return problems
