"""A flat model whose inner equations take inputs, so that what they lack can be found and added.

A force between two states appears in no derivative alone: a tyre acts on the sideslip and on the yaw rate,
friction at a pivot on both equations of motion. An input is added where such a force is calculated, in a
balance that holds several derivatives, or to a product that stands in several equations.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from ..base.units import known_unit, measures
from .flat_text import equations_of, quoted
from .flat_units import Measures
from .flatten import Json
from .show import printable
from .sources import load_sources

# Units of what acts or flows, and words for it; units of what laws read.
_ACTING = {"N": "force", "N.m": "torque", "W": "power", "A": "current", "V": "voltage", "Pa": "pressure",
           "kg/s": "flow", "m3/s": "flow"}  # fmt: skip
_READ = ("m/s", "rad/s", "m", "rad", "K", "Pa", "V", "A")
# Longest sum that is a signal's name.
_LONGEST = 60


@dataclass(frozen=True)
class Opening:
    """An input that is added inside a model.

    Attributes:
        name: of the input: the variable that an equation calculates, or one made up for an output, a balance
            or a product.
        equation: as the flat model has it; of a product, itself and others in the same equations.
        before: output, the variable without what is added; "" in a balance.
        signals: outputs, variables and sums in the equation that laws may read.
    """

    name: str
    equation: str
    before: str = ""
    signals: tuple[str, ...] = ()


def opened_model(
    model_file: Path, *, model: str | None = None, only: Sequence[str] | None = None
) -> tuple[str, tuple[Opening, ...]]:
    """The flat text of a model with inputs in its inner equations.

    Args:
        model_file, model: as for `build`.
        only: names of openings; None: all.
    Returns: the text, and the openings. Without any, the text is that of `show_model`.
    Raises: BuildError as a build does.
    """
    from .build import illustrating
    from .hybrid.front_end import library_paths

    with illustrating(None):
        tree = load_sources(Path(model_file))
    with illustrating(tree):
        name, folders = tree.model_name(model), library_paths(())
        flat, printed = printable(tree, name, folders)
        opening = _Opener(flat, printed, only)
        return opening.text(), tuple(opening.made)


class _Opener:
    """Adds inputs to a flat representation, which it copies."""

    def __init__(self, flat: Json, printed: Callable[[Json], str], only: Sequence[str] | None) -> None:
        self._flat, self._printed, self._only = deepcopy(flat), printed, only
        self._measures = Measures(flat)
        self.made: list[Opening] = []
        # Lines of declarations and equations that the printer does not know.
        self._declared: list[str] = []
        self._equations: list[str] = []
        variables = self._flat["variables"]
        scalars = {
            name: one["causality"] for name, one in variables.items()
            if isinstance(one["variability"], str) and not one["dims"] and not one["is_discrete_type"]
        }  # fmt: skip
        self._locals = {name for name, one in scalars.items() if isinstance(one, str) or "." in name}
        self._states = {state for one in self._flat["equations"] for state in _derived(one)}
        # Outputs that the model itself reads, too: a law at such an output acts outside only.
        read = Counter(name for one in self._flat["equations"] for name in _names(one["residual"]))
        self._read_outputs = {
            name
            for name, one in scalars.items()
            if isinstance(one, dict) and "Output" in one and read[name] > 1
        }
        looped = {k for family in flat["structured_equations"] for k in equations_of(family)}
        for number, one in enumerate(flat["equations"]):
            binary = one["residual"].get("Binary") if isinstance(one["residual"], dict) else None
            if number not in looped and binary and binary["op"] == "Sub":
                self._open(number, binary["lhs"], binary["rhs"])
        self._open_products([k for k in range(len(flat["equations"])) if k not in looped])

    def text(self) -> str:
        """The model's text."""
        text = self._printed(self._flat)
        declared, equations = "".join(self._declared), "".join(self._equations)
        head = list(re.finditer(r"^model .*\n", text, re.MULTILINE))[-1]
        text = text[: head.end()] + declared + text[head.end() :]
        return re.sub(r"^equation\n", f"equation\n{equations}", text, count=1, flags=re.MULTILINE)

    def _open(self, number: int, left: Json, right: Json) -> None:
        """Add an input to an equation of the form left = right, where something acts or flows in it."""
        name = _name_of(left)
        if name is None and len(_derived(left) | _derived(right)) > 1:
            self._balance(number, left, right)
        elif name in (self._locals | self._read_outputs) - self._states and not _derived(right):
            unit = self._flat["variables"][name]["unit"]
            acts = self._known(unit, _ACTING)
            if acts and name not in _names(right) and _names(right) and not _is_alias(right):
                self._variable(number, name, unit, left, right)

    def _variable(self, number: int, name: str, unit: str, left: Json, right: Json) -> None:
        output = name in self._read_outputs
        added, before = f"{_plain(name)}_inside" if output else _plain(name), f"{_plain(name)}_before"
        one = self._listed(added, f"{self._shown(left)} = {self._shown(right)}", right, unit)
        if one is None or before in self._flat["variables"]:
            return
        self.made.append(replace(one, before=before))
        self._flat["equations"][number]["residual"]["Binary"]["lhs"] = _reference(before)
        if output:
            self._equations.append(f"  {quoted(name)} = {before} + {added};\n")
        else:

            def named(body: Json) -> bool:
                return _name_of(body) == name

            whole = {"Binary": {"op": "Add", "lhs": _reference(before), "rhs": _reference(added)}}
            for k, equation in enumerate(self._flat["equations"]):
                if k != number:
                    equation["residual"] = _replaced(equation["residual"], named, whole)
            for key in ("when_chains", "assert_equations", "initial_equations"):
                self._flat[key] = _replaced(self._flat[key], named, whole)
            del self._flat["variables"][name]
        self._declare("input", added, unit)
        self._declare("output", before, unit)

    def _balance(self, number: int, left: Json, right: Json) -> None:
        sides = [one for one in (left, right) if _names(one)]
        unit = next((one for one in _ACTING for side in sides if self._measures.fit(side, one)), "")
        states = sorted(_derived(left) | _derived(right))
        own = [one for one in states if unit and self._power(unit, one)] or states
        inputs = set(self._flat["variables"]) - self._locals - self._states
        free = [
            one for one in _names(left) | _names(right)
            if one in inputs and not isinstance(self._flat["variables"][one]["causality"], str)
        ]  # fmt: skip
        if not unit or free:
            return  # an input that adds to the balance is a place already
        sign = _sign_of(left, own[0]) or -_sign_of(right, own[0])
        name = f"{_ACTING[unit]}_on_{_plain(own[0])}"
        both = {"Binary": {"op": "Add", "lhs": left, "rhs": right}}
        one = self._listed(name, f"{self._shown(left)} = {self._shown(right)}", both, unit)
        if one is None or not sign or name in self._flat["variables"]:
            return
        self.made.append(one)
        binary = self._flat["equations"][number]["residual"]["Binary"]
        added = {"op": "Add" if sign > 0 else "Sub", "lhs": binary["rhs"], "rhs": _reference(name)}
        binary["rhs"] = _reference(name) if sign > 0 and self._shown(right) == "0" else {"Binary": added}
        self._declare("input", name, unit)

    def _open_products(self, numbers: Sequence[int]) -> None:
        """Add an input to each force or flow that stands in several equations as the same product.

        Those that stand in the same equations act together. So laws there may read the signals of all.
        """
        equations, variables = self._flat["equations"], self._flat["variables"]
        held: dict[str, set[int]] = {}
        products: dict[str, Json] = {}
        for number in numbers:
            for one in _products(equations[number]["residual"]):
                key = _bare(one)
                held.setdefault(key, set()).add(number)
                products.setdefault(key, one)
        together: dict[frozenset[int], list[Opening]] = {}
        for key, body in products.items():
            if len(held[key]) < 2:
                continue
            unit = next((one for one in _ACTING if self._measures.fit(body, one)), "")
            varies = any(variables[one]["variability"] == "Empty" for one in _names(body) if one in variables)
            shown = self._shown(body)
            name = f"{_ACTING.get(unit, '')}_of_{_plain(shown)}"
            if not unit or not varies or len(shown) > _LONGEST or name in variables:
                continue
            one = self._listed(name, shown, body, unit)
            if one is None:
                continue
            together.setdefault(frozenset(held[key]), []).append(replace(one, before=f"{name}_before"))
            whole = {"Binary": {"op": "Add", "lhs": body, "rhs": _reference(name)}}
            for number in held[key]:
                residual = equations[number]["residual"]
                equations[number]["residual"] = _replaced(residual, partial(_is_bare, key), whole)
            self._equations.append(f"  {name}_before = {shown};\n")
            self._declare("input", name, unit)
            self._declare("output", f"{name}_before", unit)
        for where, some in together.items():
            signals = tuple(dict.fromkeys(each for one in some for each in one.signals))
            about = f"{' and '.join(one.equation for one in some)}, in {len(where)} equations"
            self.made += [replace(one, equation=about, signals=signals) for one in some]

    def _listed(self, name: str, equation: str, body: Json, unit: str) -> Opening | None:
        """An opening with the signals in its equation, which become outputs; None if it is not asked for."""
        if self._only is not None and name not in self._only:
            return None
        signals = []
        for one in sorted(_names(body) & self._locals - self._states):
            declared = self._flat["variables"].get(one)
            if declared is None or not self._known(declared["unit"], _READ) or declared["unit"] == unit:
                continue
            if _plain(one) not in {each for opening in self.made for each in opening.signals}:
                self._declare("output", _plain(one), declared["unit"])
                if _plain(one) == one:
                    del self._flat["variables"][one]
                else:
                    self._equations.append(f"  {_plain(one)} = {quoted(one)};\n")
            signals.append(_plain(one))
        for part in _sums(body):
            shown, read = self._shown(part), self._unit_of(part)
            # A dot in a name would mean a component.
            sign = f"'{re.sub(r'[.](?=[0-9])', ',', shown.replace(chr(39), '')).replace('.', '_')}'"
            if not read or len(shown) > _LONGEST or _derived(part) or read == unit:
                continue
            if sign not in {one for each in self.made for one in each.signals}:
                self._declare("output", sign, read)
                self._equations.append(f"  {sign} = {shown};\n")
            signals.append(sign)
        return Opening(name, equation, signals=tuple(dict.fromkeys(signals)))

    def _unit_of(self, part: Json) -> str:
        """Unit of a sum that laws can read: that of one of its terms; "" if it is another one."""
        names = [_name_of(one) for one in _terms(part)]
        units = [self._flat["variables"].get(one, {}).get("unit") for one in names if one]
        declared = [one for one in units if isinstance(one, str) and self._known(one, _READ)]
        # Numbers among the other terms often have units, which nothing declares.
        fitting = (one for one in _READ if self._measures.fit(part, one))
        return declared[0] if declared else next(fitting, "")

    def _power(self, unit: str, state: str) -> bool:
        """Whether a unit times that of a state is a power."""
        own = known_unit(self._flat["variables"].get(state, {}).get("unit") or "")
        acts, power = known_unit(unit), known_unit("W")
        if own is None or acts is None or power is None:
            return False
        pairs = zip(own.exponents, acts.exponents, power.exponents, strict=True)
        return all(a + b == c for a, b, c in list(pairs)[:-1])

    @staticmethod
    def _known(unit: Any, units: Any) -> bool:
        return isinstance(unit, str) and measures(unit, units)

    def _declare(self, word: str, name: str, unit: Any) -> None:
        start = ", start = 0" if word == "input" else ""
        self._declared.append(f'  {word} Real {quoted(name)}(unit = "{unit}"{start});\n')

    def _shown(self, body: Json) -> str:
        """An expression's text."""
        empty = {key: [] if isinstance(value, list) else value for key, value in self._flat.items()}
        alone = {"residual": {"Binary": {"op": "Sub", "lhs": _reference("x"), "rhs": body}}}
        text = self._printed({**empty, "variables": {}, "functions": {}, "equations": [alone]})
        return text.partition("x = ")[2].rpartition(";\nend")[0]


def _reference(name: str) -> Json:
    return {"VarRef": {"name": {"name": name}, "subscripts": []}}


def _name_of(body: Json) -> str | None:
    """The variable that an expression is, without subscripts."""
    one = body.get("VarRef") if isinstance(body, dict) else None
    return None if one is None or one["subscripts"] else str(one["name"]["name"])


def _plain(name: str) -> str:
    """A name without dots and subscripts, for a variable of the model itself."""
    return re.sub(r"\W+", "_", name).strip("_")


def _is_alias(body: Json) -> bool:
    """Whether an expression is a variable, or its negative."""
    return _name_of(body["Unary"]["rhs"] if "Unary" in body else body) is not None


def _nodes(body: Any) -> Iterator[Json]:
    """All parts of an expression; not what stands below a derivative."""
    if isinstance(body, list):
        for one in body:
            yield from _nodes(one)
    elif isinstance(body, dict):
        yield body
        if body.get("BuiltinCall", {}).get("function") != "Der":
            for one in body.values():
                yield from _nodes(one)


def _names(body: Any) -> set[str]:
    """Variables in an expression."""
    return {name for one in _nodes(body) if "VarRef" in one and (name := _name_of(one)) and name != "time"}


def _derived(body: Any) -> set[str]:
    """Variables whose derivative stands in an expression."""
    calls = [one["BuiltinCall"] for one in _nodes(body) if "BuiltinCall" in one]
    return {name for one in calls if one["function"] == "Der" and (name := _name_of(one["args"][0]))}


def _products(body: Any) -> Iterator[Json]:
    """Products and quotients in an expression, the parts of one after it."""
    for one in _nodes(body):
        if one.get("Binary", {}).get("op") in ("Mul", "Div") and not _derived(one):
            yield one


def _bare(body: Any) -> str:
    """A text that is equal for equal expressions."""
    if isinstance(body, dict):
        name = _name_of(body)
        parts = (f"{key}:{_bare(one)}" for key, one in body.items() if key != "span")
        return name or f"({','.join(parts)})"
    return f"[{','.join(map(_bare, body))}]" if isinstance(body, list) else str(body)


def _is_bare(key: str, body: Json) -> bool:
    return _bare(body) == key


def _terms(body: Json) -> Iterator[Json]:
    """The terms of a sum."""
    binary = body.get("Binary")
    if binary and binary["op"] in ("Add", "Sub"):
        yield from _terms(binary["lhs"])
        yield from _terms(binary["rhs"])
    else:
        yield body


def _sums(body: Any) -> Iterator[Json]:
    """The sums in an expression that are no part of another sum."""
    binary = body.get("Binary") if isinstance(body, dict) else None
    if binary and binary["op"] in ("Add", "Sub"):
        yield body
        for one in _terms(body):
            yield from _sums(one)
    elif isinstance(body, dict | list):
        for one in body.values() if isinstance(body, dict) else body:
            yield from _sums(one)


def _sign_of(body: Json, state: str) -> int:
    """Sign of the term that holds a derivative, 0 if there is none."""
    if state not in _derived(body):
        return 0
    ((kind, one),) = body.items()
    if kind == "Unary":
        return (-1 if "Minus" in one["op"] else 1) * _sign_of(one["rhs"], state)
    if kind == "Binary":
        here = "lhs" if state in _derived(one["lhs"]) else "rhs"
        return (-1 if one["op"] == "Sub" and here == "rhs" else 1) * _sign_of(one[here], state)
    return 1


def _replaced(body: Any, chosen: Callable[[Json], bool], by: Json) -> Any:
    """An expression with the parts that are chosen replaced."""
    if isinstance(body, list):
        return [_replaced(one, chosen, by) for one in body]
    if not isinstance(body, dict):
        return body
    if chosen(body):
        return by
    return {key: _replaced(one, chosen, by) for key, one in body.items()}
