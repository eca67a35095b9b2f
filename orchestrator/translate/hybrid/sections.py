"""Algorithm sections that the compiler refuses: their statements are carried out in symbols.

A section that `hidden_sections` has taken out leaves a parameter in each component that has it. Its variables
get their values as equations, or as discrete values; loops are unrolled, those of unknown length become
functions in C.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from orchestrator.base.digests import digest_of
from orchestrator.base.errors import BuildError

from ..rewriting.class_bodies import MARK
from ..rewriting.hidden_sections import Section
from . import expression as ex
from .arrays import each
from .expression import Expr
from .functions import call
from .section_values import EVENTS, Env, SectionValues, UnknownLength
from .statements import FunctionSource, Node, Parser

_MOST_TURNS = 100_000


def hidden_section(name: str, sections: Mapping[str, Section]) -> tuple[str, Section] | None:
    """The component and the section that a variable stands for; None if it is an ordinary one."""
    owner, _, last = name.rpartition(".")
    found = re.match(rf"{MARK}section_([0-9a-f]+)_of_", last)
    return (owner, sections[found[1]]) if found and found[1] in sections else None


def _assigned(statements: Iterable[Node], by_events: bool = False) -> Iterator[tuple[Node, bool]]:
    """What statements assign, and whether a when-statement does."""
    for one in statements:
        match one[0]:
            case "assign":
                yield from ((target, by_events) for target in one[1] if target is not None)
            case "if":
                for _, body in one[1]:
                    yield from _assigned(body, by_events)
                yield from _assigned(one[2], by_events)
            case "when":
                for _, body in one[1]:
                    yield from _assigned(body, True)
            case "for" | "while":
                yield from _assigned(one[2], by_events)


def _parsed(section: Section) -> tuple[Parser, list[Node]]:
    source = FunctionSource(section.scope, section.text)
    parser = Parser(source, f"the algorithm section of {section.scope}")
    return parser, parser.section()


def set_by_events(owner: str, section: Section) -> list[str]:
    """Names of variables that a section's when-statements assign; an index of a component is left out."""
    head = f"{owner}." if owner else ""
    return [f"{head}{target[1]}" for target, by_events in _assigned(_parsed(section)[1]) if by_events]


class SectionEvaluation(SectionValues):
    """Symbolic execution of one algorithm section of one component.

    Attributes:
        equations: zero at the solution.
        values: what discrete variables are.
        starts: of an initial algorithm, targets and their values.
    """

    def __init__(self, model: Any, owner: str, section: Section) -> None:
        super().__init__(model, owner, section)
        self._parser, self._body = _parsed(section)
        self._path: Expr = ex.ONE
        self._trigger: int | None = None
        self._set: dict[int, np.ndarray] = {}
        self.equations: list[Expr] = []
        self.values: list[tuple[Expr, Expr]] = []
        self.starts: list[tuple[Expr, Expr]] = []
        before = model.events_so_far()
        self._execute()  # finds which elements are assigned
        model.forget_events(before)
        self._known, self._set, self._done = self._set, {}, set()
        self.equations, self.values, self.starts = [], [], []
        self._execute()

    # Statements

    def _execute(self) -> None:
        env: Env = {}
        last: dict[int, int] = {}
        for place, statement in enumerate(self._body):
            for target, _ in _assigned([statement]):
                for number in self._all_of(target):
                    last[number] = place
        for place, statement in enumerate(self._body):
            self._do([statement], env)
            for number in [one for one, end in last.items() if end == place and one in self._set]:
                self._define(number, env.pop(number))
                self._done.add(number)

    def _define(self, number: int, values: np.ndarray) -> None:
        places, chosen = self._model.places_of(number), self._set[number]
        for place, value, done in zip(places.ravel(), np.ravel(values), chosen.ravel(), strict=True):
            if not done:
                continue
            if self._section.initial:
                self.starts.append((place, value))
            elif self._model.role_of(place) == "discrete":
                self.values.append((place, value))
            else:
                self.equations.append(ex.sub(place, value))

    def _do(self, statements: Sequence[Node], env: Env) -> None:
        for one in statements:
            match one[0]:
                case "assign":
                    self._assign(one[1], one[2], env)
                case "if":
                    self._branches(one[1], one[2], env)
                case "for" | "while":
                    self._loop(one, env)
                case "when":
                    self._when(one[1], env)
                case "do":
                    self._call(one[1], env)
                case _:
                    raise UnknownLength

    def _assign(self, targets: Sequence[Node | None], value: Node, env: Env) -> None:
        if len(targets) > 1:
            if value[0] != "call":
                raise self._refusal("several targets of what is no function")
            results = self._function(value, env)
        else:
            results = [self._value(value, env)]
        for target, result in zip(targets, results, strict=False):
            if target is not None:
                self._store(target, result, env)

    def _store(self, target: Node, result: Any, env: Env) -> None:
        number, subscripts = self._variable(target, env)
        if number is None:
            raise self._refusal(f"the assignment to {target[1]}")
        base = np.array(self._current(number, env), dtype=object)
        done = self._set.setdefault(number, np.zeros(base.shape, dtype=bool))
        places = self._places(base.shape, subscripts, env)
        values = np.asarray(result, dtype=object)
        if any(isinstance(one, Expr) for one in places):
            axis = next(k for k, one in enumerate(places) if isinstance(one, Expr))
            if len([one for one in places if isinstance(one, Expr)]) > 1 or values.ndim:
                raise self._refusal(f"several subscripts of {target[1]} that change while the model runs,")
            self._model.keep_within(places[axis], base.shape[axis], self._here)
            for k in range(base.shape[axis]):
                at = tuple(k if one is places[axis] else one for one in places)
                here = ex.logical("eq", places[axis], ex.number(k + 1))
                base[at] = ex.conditional(here, values.item(), base[at])
                done[at] = True
        else:
            at = tuple(places)
            if np.ndim(base[at]) != values.ndim and values.ndim:
                raise self._refusal(f"the assignment of an array to {target[1]}, which has another size,")
            base[at] = values if values.ndim else values.item()
            done[at] = True
        env[number] = base

    def _branches(self, cases: Sequence[tuple[Node, list[Node]]], otherwise: list[Node], env: Env) -> None:
        if not cases:
            self._do(otherwise, env)
            return
        condition = self._scalar(cases[0][0], env)
        if condition.op == "num":
            if condition.args[0]:
                self._do(cases[0][1], env)
            else:
                self._branches(cases[1:], otherwise, env)
            return
        yes, no, path = dict(env), dict(env), self._path
        self._path = ex.logical("and", path, condition)
        with self._model.guarded(condition):
            self._do(cases[0][1], yes)
        self._path = ex.logical("and", path, ex.logical("not", condition))
        with self._model.guarded(ex.logical("not", condition)):
            self._branches(cases[1:], otherwise, no)
        self._path = path
        self._merge(condition, yes, no, env)

    def _merge(self, condition: Expr, yes: Env, no: Env, env: Env) -> None:
        for number in {*yes, *no}:
            a, b = self._current(number, yes), self._current(number, no)
            if a is not b:
                choose = partial(ex.conditional, condition)
                env[number] = np.asarray(each(choose, a, b), dtype=object)

    def _loop(self, statement: Node, env: Env) -> None:
        before, loops, path = dict(env), dict(self._loops), self._path
        events = self._model.events_so_far()
        try:
            if statement[0] == "while":
                turns = 0
                while True:
                    condition = self._scalar(statement[1], env)
                    turns += 1
                    if condition.op != "num" or turns > _MOST_TURNS:
                        raise UnknownLength
                    if not condition.args[0]:
                        return
                    self._do(statement[2], env)
            else:
                self._turns(statement[1], statement[2], env)
        except UnknownLength:
            self._model.forget_events(events)
            self._loops, self._path = loops, path
            env.clear()
            env.update(before)
            self._as_function(statement, env)

    def _turns(self, iterators: Sequence[tuple[str, Node]], body: list[Node], env: Env) -> None:
        (name, over), rest = iterators[0], iterators[1:]
        outer = self._loops.get(name)
        for value in np.ravel(self._value(over, env)):
            self._loops[name] = value
            if rest:
                self._turns(rest, body, env)
            else:
                self._do(body, env)
        self._loops.pop(name, None)
        if outer is not None:
            self._loops[name] = outer

    def _as_function(self, statement: Node, env: Env) -> None:
        """A loop of unknown length, as a function of all variables that it names."""
        written: dict[str, int] = {}
        for target, by_events in _assigned([statement]):
            number, _ = self._variable(target, env)
            if by_events or number is None or "." in target[1] or any(s for _, s in target[3][:-1]):
                raise self._refusal(f"a loop of unknown length that assigns {target[1]}")
            written[target[1]] = number
        read: dict[str, Any] = {}
        for name in dict.fromkeys(_names(statement)):
            if name in self._loops:
                read[name] = self._loops[name]
            elif "." not in name and (number := self._model.number_of(self._path_to(name))) is not None:
                read[name] = self._current(number, env)
        inputs, outputs, copies = [], [], []
        for name, value in read.items():
            size = f"[{', '.join(map(str, np.shape(value)))}]" if np.ndim(value) else ""
            if name in written:
                inputs.append(f"input Real {MARK}{name}{size};")
                outputs.append(f"output Real {name}{size};")
                copies.append(f"{name} := {MARK}{name};")
            else:
                inputs.append(f"input Real {name}{size};")
        body = " ".join([*inputs, *outputs, "algorithm", *copies, f"{self._parser.text_of(statement)};"])
        name = f"loop_{digest_of(body.encode())[:8]}"
        source = FunctionSource(f"{self._section.scope}.{name}", f"function {name} {body} end {name};")
        results = call(source, self._model.function_texts, list(read.values()))
        self._model.need_value(results[0], f"the loop in {self._section.scope}", self._here)
        for one, result in zip([one for one in read if one in written], results, strict=True):
            number = written[one]
            self._set[number] = np.ones(result.shape, dtype=bool)
            env[number] = result

    def _when(self, cases: Sequence[tuple[Node, list[Node]]], env: Env) -> None:
        if self._trigger is not None or self._path is not ex.ONE:
            raise self._refusal("a when-statement within another statement")
        found: list[tuple[Expr, Env]] = []
        for condition, body in cases:
            number = self._condition(condition, env)
            inside = dict(env)
            events = self._model.hold(False)
            self._trigger = number
            with self._model.guarded(ex.symbol("rise", number)):
                self._do(body, inside)
            self._trigger = None
            self._model.hold(events)
            found.append((ex.symbol("rise", number), inside))
        for rise, inside in reversed(found):
            later = dict(env)
            self._merge(rise, inside, later, env)

    def _condition(self, node: Node, env: Env) -> int:
        """Number of the condition that an expression is, made where it has none."""
        add = self._model.add_condition
        match node[0]:
            case "array":
                numbers = [self._condition(one, env) for one in node[1]]
                found = numbers[0]
                for one in numbers[1:]:
                    found = add("rise", found, one)
                return int(found)
            case "call" if node[1] in ("initial", "terminal"):
                return int(add(node[1]))
            case "call" if node[1] == "sample":
                start, period = (self._model.number(self._scalar(one, env), "sample()") for one in node[2])
                return int(self._model.add_clock(start, period))
            case "binary" if node[1] in ("and", "or") and _has_events(node):
                return int(add(node[1], self._condition(node[2], env), self._condition(node[3], env)))
            case "not" if _has_events(node):
                return int(add("not", self._condition(node[1], env)))
        return int(add("value", self._scalar(node, env)))

    def _call(self, node: Node, env: Env) -> None:
        name = node[1]
        if node[0] != "call":
            raise self._refusal(f"the statement {name}")
        match name.rpartition(".")[2]:
            case "assert":
                holds = self._scalar(node[2][0], env)
                level = [*node[2][2:3], *(value for key, value in node[3].items() if key == "level")]
                warns = bool(level) and str(level[0][1]).endswith("warning")
                if self._path is not ex.ONE:
                    holds = ex.logical("or", ex.logical("not", self._path), holds)
                if self._trigger is not None:
                    quiet = ex.logical("not", ex.symbol("rise", self._trigger))
                    holds = ex.logical("or", quiet, holds)
                kind = "warning" if warns else "assert"
                self._model.add_action(kind, None, value=holds, message=_text(node))
            case "terminate":
                if self._trigger is None or self._path is not ex.ONE:
                    raise self._refusal("terminate() outside a when-statement, or under a condition,")
                self._model.add_action("terminate", self._trigger, message=_text(node))
            case "reinit":
                number, subscripts = self._variable(node[2][0], env)
                if self._trigger is None or number is None:
                    raise self._refusal("reinit() outside a when-statement")
                states = self._model.places_of(number)
                chosen = self._places(states.shape, subscripts, env)
                if any(isinstance(one, Expr) for one in chosen):
                    raise self._refusal("reinit() of an element whose subscript changes")
                states = np.asarray(states[tuple(chosen)], dtype=object)
                if any(self._model.role_of(one) != "state" for one in states.ravel()):
                    raise BuildError(
                        f"{self._section.file}:{self._section.line}: reinit() of {node[2][0][1]}, which is "
                        "no state; reinit a variable whose der() stands in an equation"
                    )
                value = np.asarray(self._value(node[2][1], env), dtype=object)
                value = np.broadcast_to(value, states.shape)
                for place, one in zip(states.ravel(), value.ravel(), strict=True):
                    kept = ex.conditional(self._path, one, place)
                    self._model.add_action("reinit", self._trigger, target=place, value=kept)
            case "print":
                pass  # it changes no value
            case _:
                raise self._refusal(f"the statement {name}()")


def _has_events(node: Any) -> bool:
    if isinstance(node, tuple) and node[:1] == ("call",) and node[1] in EVENTS:
        return True
    return isinstance(node, tuple | list) and any(_has_events(one) for one in node)


def _names(node: Any) -> Iterator[str]:
    """All names in statements."""
    if isinstance(node, tuple) and len(node) == 4 and node[0] == "name":
        yield node[1]
        yield from _names(node[2])
    elif isinstance(node, tuple | list):
        yield from itertools.chain.from_iterable(map(_names, node))
    elif isinstance(node, dict):
        yield from _names(list(node.values()))


def _text(node: Node) -> str:
    """The message of assert() or terminate()."""
    texts = [one[1][1:-1] for one in node[2] if one[0] == "text"]
    return texts[0] if texts else "(a value)"
