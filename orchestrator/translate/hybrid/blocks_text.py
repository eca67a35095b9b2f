"""The sorted blocks of a model's equations in text: how the FMU computes what, and when."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from orchestrator.base.errors import listed

from .expression import Expr
from .matching import Block
from .model import Condition, DaeModel
from .structure import System

_SIGNS = {
    "or": ("or", 1), "and": ("and", 2), "lt": ("<", 4), "le": ("<=", 4), "gt": (">", 4), "ge": (">=", 4),
    "eq": ("==", 4), "ne": ("<>", 4), "add": ("+", 5), "sub": ("-", 5), "mul": ("*", 6), "div": ("/", 6),
}  # fmt: skip
_NAMES = {"fabs": "abs", "fmin": "min", "fmax": "max", "trunc": "integer"}
# Longer expressions end with an ellipsis: written out in full, what they share is repeated without end.
_LONGEST = 400


def blocks_text(system: System) -> str:
    """The text: states, initial system, blocks, constraints, events."""
    return "\n".join(_Text(system).lines()) + "\n"


class _Text:
    def __init__(self, system: System) -> None:
        self._system = system
        self._model: DaeModel = system.model

    def lines(self) -> Iterator[str]:
        system, model = self._system, self._model
        inputs = [one.name for one in model.variables if one.role == "input"]
        scalars = sum(1 for one in system.blocks if one.value is not None)
        coupled = [one for one in system.blocks if one.value is None]
        yield (
            f"{model.name}: {len(system.states)} states, {len(inputs)} inputs, {len(system.blocks)} blocks: "
            f"{scalars} explicit, {len(coupled)} solved as systems"
        )
        yield ""
        yield f"Inputs: {listed(inputs, 40)}"
        yield f"States: {listed((model.name_of(one) for one in system.states), 40)}"
        if system.constraints:
            free = len(system.states) - len(system.constraints)
            yield (
                f"  {len(system.constraints)} constraints bind the states: {free} degrees of freedom. All "
                "states are integrated,"
            )
            yield "  and each step ends on the constraints (index reduction by Pantelides' algorithm):"
            for one in system.constraints:
                yield f"    0 = {self._text(one)}"
        aliases = [
            f"{model.variables[one.args[1]].name} = {self._text(value)}"
            for one, value in system.aliases.items()
        ]
        if aliases:
            yield f"Aliases: {listed(aliases, 40)}"
        yield ""
        yield "Initial system (once, before the first step)"
        yield from self._blocks(system.initial_blocks)
        yield ""
        yield "Blocks (at each evaluation, in this order)"
        yield from self._blocks(system.blocks)
        yield from self._events()
        for note in system.notes:
            yield f"Note: {note}"

    def _blocks(self, blocks: Iterable[Block]) -> Iterator[str]:
        number = 0
        for number, block in enumerate(blocks, 1):
            if block.value is not None:
                yield f"  {number:>4}  {self._text(block.unknowns[0])} := {self._text(block.value)}"
                continue
            kind = "linear" if block.linear else "nonlinear"
            names = listed((self._text(one) for one in block.unknowns), 12)
            total = len(block.unknowns) + len(block.inner)
            size = f"{total} equations" if total > 1 else "1 equation"
            how = "" if block.linear else ", by Newton's method"
            how += "" if block.jacobian is not None else ", Jacobian by differences"
            torn = f", torn: {len(block.unknowns)} iterated" if block.inner else ""
            yield f"  {number:>4}  {kind} system of {size}{torn}{how}; iterates {names}"
            for one, value in block.inner:
                yield f"          {self._text(one)} := {self._text(value)}"
            for residual in block.residuals:
                yield f"          0 = {self._text(residual)}"
        if not number:
            yield "        none"

    def _events(self) -> Iterator[str]:
        model = self._model
        if model.modes or model.clocks or model.instants or model.discretes or model.actions:
            yield ""
            yield "Events"
        for number, one in enumerate(model.modes, 1):
            yield f"  e{number}: state event where {self._text(one)} changes"
        for phase, period in model.clocks:
            yield f"  ticks at {phase:g} s, {phase + period:g} s, ... (period {period:g} s)"
        if model.instants:
            yield f"  times known beforehand: {listed((f'{one:g} s' for one in model.instants), 12)}"
        for one in model.discretes:
            name = self._text(one.target)
            for branch in one.branches:
                yield f"  {name} := {self._text(branch.value)}{self._when(branch.trigger)}"
        for action in model.actions:
            when = self._when(action.trigger)
            if action.kind == "reinit" and action.target is not None and action.value is not None:
                yield f"  reinit({self._text(action.target)}, {self._text(action.value)}){when}"
            elif action.kind == "terminate":
                yield f"  terminate({action.message!r}){when}"
            else:
                yield f"  {action.kind}: {action.message!r}"

    def _when(self, trigger: int | None) -> str:
        return "" if trigger is None else f" when {self._condition(trigger)}"

    def _condition(self, number: int) -> str:
        one: Condition = self._model.conditions[number]
        match one.kind:
            case "always" | "initial":
                return "initial()" if one.kind == "initial" else "always"
            case "clock":
                phase, period = self._model.clocks[one.operands[0]]
                return f"sample({phase:g}, {period:g})"
            case "not":
                return f"not ({self._condition(one.operands[0])})"
            case "and" | "or" | "rise":
                word = {"rise": ", "}.get(one.kind, f" {one.kind} ")
                return f"({word.join(self._condition(each) for each in one.operands[:2])})"
        return self._text(one.operands[0]) if one.operands else one.kind

    def _text(self, one: Expr, level: int = 0) -> str:
        found = self._full(one, level, [_LONGEST])
        return found if len(found) <= _LONGEST else f"{found[:_LONGEST]} ..."

    def _full(self, one: Expr, level: int, room: list[int]) -> str:
        """An expression; `room` is what is left of the characters that anybody reads."""
        if room[0] < 0:
            return "..."
        op, args = one.op, one.args
        if op == "num":
            return f"{args[0]:.10g}"
        if op == "sym":
            room[0] -= 4
            return self._symbol(one, level)

        def inner(arg: Expr, above: int = 0) -> str:
            return self._full(arg, above, room)

        if op in _SIGNS:
            sign, own = _SIGNS[op]
            blank = "" if own >= 6 else " "
            text = f"{inner(args[0], own)}{blank}{sign}{blank}{inner(args[1], own + 1)}"
            return f"({text})" if own < level else text
        match op:
            case "neg":
                text = f"-{inner(args[0], 6)}"
                return f"({text})" if level > 5 else text
            case "not":
                return f"not {inner(args[0], 9)}"
            case "if":
                text = f"if {inner(args[0])} then {inner(args[1])} else {inner(args[2])}"
                return f"({text})" if level > 0 else text
            case "fn:pow":
                return f"{inner(args[0], 9)}^{inner(args[1], 9)}"
        kind, _, name = op.partition(":")
        name = name if kind == "fn" else kind  # such as table
        return f"{_NAMES.get(name, name)}({', '.join(inner(arg) for arg in args if isinstance(arg, Expr))})"

    def _symbol(self, one: Expr, level: int) -> str:
        match one.args[0]:
            case "t":
                return "time"
            case "initial":
                return "initial()"
            case "homotopy":
                return "share of the actual equations"
            case "mode":
                return self._full(self._model.modes[one.args[1]], level, [200])
            case "pre":
                return f"pre({self._model.variables[one.args[1]].name})"
            case "start":
                return f"start of {self._model.variables[one.args[1]].name}"
        return self._model.name_of(one)
