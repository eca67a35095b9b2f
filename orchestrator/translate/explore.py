"""Run Python code on every path that its conditions allow, and join what the paths end with.

A call of a function is explored on its own: its paths are joined when it returns, so that the number of paths
is a sum over the calls, not a product. Paths that cannot be joined (one raises, one returns; one logs, one
does not) become a condition of the caller.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

from .traced import Tape, Traced, TraceError

MOST_PATHS = 2000
_MISSING = object()

_State = dict[int, tuple[Any, dict[str, Any]]]


@dataclass(frozen=True)
class Leaf:
    """How one path ended.

    Attributes:
        taken: the conditions decided on the way, with their answers.
        value: what was returned.
        error: what was raised, or None.
        logs: what was logged, each a status and a text.
        state: attributes of the tracked objects at the end.
    """

    taken: tuple[tuple[Traced, bool], ...]
    value: Any
    error: Exception | None
    logs: tuple[tuple[str, str], ...]
    state: _State


@dataclass
class _Frame:
    forced: Sequence[tuple[Traced, bool]]
    taken: list[tuple[Traced, bool]] = field(default_factory=list)
    logs: list[tuple[str, str]] = field(default_factory=list)


class Explorer:
    """Explores calls of the functions of one module.

    Args:
        tape: of the numbers.
        module: name of the module; instances of its classes are what a call may change.
        roots: objects from which they are reached.
    """

    def __init__(self, tape: Tape, module: str, roots: Iterable[Any] = ()) -> None:
        self.tape = tape
        self.module = module
        self.roots = list(roots)
        self._frames: list[_Frame] = []
        tape.decide = self.decide

    def decide(self, condition: Traced) -> bool:
        """The truth of a condition on the present path."""
        if not self._frames:
            raise TraceError("a condition outside of a traced call")
        for frame in self._frames:
            for known, answer in frame.taken:
                if known is condition:
                    return answer
        frame = self._frames[-1]
        place = len(frame.taken)
        answer = frame.forced[place][1] if place < len(frame.forced) else True
        frame.taken.append((condition, answer))
        return answer

    def log(self, status: str, text: str) -> None:
        """Take down what the model logs."""
        if self._frames:
            self._frames[-1].logs.append((status, text))

    def explore(self, run: Callable[[], Any], arguments: Iterable[Any] = ()) -> list[Leaf]:
        """All paths of a call; what it changed is put back.

        Raises: TraceError if there are too many, or for whatever the code cannot do with traced numbers.
        """
        roots = [*self.roots, *arguments]
        entry = self._snapshot(roots)
        pending: list[list[tuple[Traced, bool]]] = [[]]
        leaves: list[Leaf] = []
        while pending:
            if len(leaves) == MOST_PATHS:
                raise TraceError(
                    f"more than {MOST_PATHS} paths through one function; put independent conditions into "
                    "functions of their own, which are joined where they return"
                )
            frame = _Frame(pending.pop())
            self._restore(entry)
            self._frames.append(frame)
            value, error = None, None
            try:
                value = run()
            except TraceError:
                raise
            except (ArithmeticError, ValueError, RuntimeError) as caught:
                error = caught
            finally:
                self._frames.pop()
            for place in range(len(frame.forced), len(frame.taken)):
                condition, answer = frame.taken[place]
                pending.append([*frame.taken[:place], (condition, not answer)])
            leaves.append(Leaf(tuple(frame.taken), value, error, tuple(frame.logs), self._snapshot(roots)))
        self._restore(entry)
        return leaves

    def joined(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, its paths joined at every call while tracing."""

        @functools.wraps(function)
        def call(*arguments: Any, **options: Any) -> Any:
            if not self._frames:
                return function(*arguments, **options)
            leaves = self.explore(lambda: function(*arguments, **options), [*arguments, *options.values()])
            groups = self.groups(leaves, self._signature)
            chosen = groups[-1]
            for group in groups[:-1]:
                condition = self.member_condition(leaves, group)
                if condition:
                    chosen = group
                    break
            first = chosen[0]
            if len(chosen) == 1:
                value, state, error = first.value, first.state, first.error
            else:
                value = self.merge(leaves, chosen, lambda leaf: leaf.value)
                error = first.error
                state = self._merged_state(leaves, chosen)
            self._restore(state)
            self._frames[-1].logs += first.logs
            if error is not None:
                raise error
            return value

        return call

    def _merged_state(self, leaves: Sequence[Leaf], members: Sequence[Leaf]) -> _State:
        merged: _State = {}
        for key, (item, attributes) in members[0].state.items():
            values = {
                name: self.merge(leaves, members, lambda leaf, at=(key, name): leaf.state[at[0]][1][at[1]])
                for name in attributes
            }
            merged[key] = item, values
        return merged

    @staticmethod
    def groups(leaves: Sequence[Leaf], key: Callable[[Leaf], Hashable]) -> list[list[Leaf]]:
        """Leaves with the same key, in the order of their first."""
        found: dict[Hashable, list[Leaf]] = {}
        for leaf in leaves:
            found.setdefault(key(leaf), []).append(leaf)
        return list(found.values())

    def merge(self, leaves: Sequence[Leaf], members: Sequence[Leaf], value: Callable[[Leaf], Any]) -> Any:
        """The value of whichever of the members applies; where none does, anything."""
        inside = {id(leaf) for leaf in members}

        def join(some: Sequence[Leaf], depth: int) -> Any:
            if len(some) == 1:
                return value(some[0]) if id(some[0]) in inside else _MISSING
            condition = some[0].taken[depth][0]
            yes, no = (
                join([leaf for leaf in some if leaf.taken[depth][1] is answer], depth + 1)
                for answer in (True, False)
            )
            if yes is _MISSING or no is _MISSING:
                return no if yes is _MISSING else yes
            return self.tape.select(condition, yes, no)

        return join(leaves, 0)

    def member_condition(self, leaves: Sequence[Leaf], members: Sequence[Leaf]) -> Any:
        """Whether one of the members applies."""
        inside = {id(leaf) for leaf in members}
        return self.merge(leaves, leaves, lambda leaf: id(leaf) in inside)

    def _signature(self, leaf: Leaf) -> Hashable:
        state = tuple(
            (key, tuple((name, _shape(value)) for name, value in attributes.items()))
            for key, (_, attributes) in leaf.state.items()
        )
        error = None if leaf.error is None else (type(leaf.error), str(leaf.error))
        return error, leaf.logs, _shape(leaf.value), state

    def _snapshot(self, roots: Iterable[Any]) -> _State:
        found: _State = {}
        waiting = list(roots)
        while waiting:
            item = waiting.pop()
            if id(item) in found or type(item).__module__ != self.module or not hasattr(item, "__dict__"):
                continue
            found[id(item)] = item, dict(vars(item))
            waiting.extend(vars(item).values())
        return dict(sorted(found.items()))

    @staticmethod
    def _restore(state: _State) -> None:
        for item, attributes in state.values():
            vars(item).clear()
            vars(item).update(attributes)


def _shape(value: Any) -> Hashable:
    """What has to be equal for two values to be joined."""
    if isinstance(value, Traced | bool | int | float):
        return "number"
    if value is None:
        return None
    if isinstance(value, str):
        return "text"
    if isinstance(value, tuple):
        return type(value), tuple(map(_shape, value))
    return id(value)
