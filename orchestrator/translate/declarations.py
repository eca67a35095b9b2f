"""Read the declarations of the compiler's flat representation: one variable per scalar."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence, Set
from dataclasses import replace
from typing import Any

import numpy as np

from orchestrator.base.errors import BuildError

from .expressions import ExpressionReader, Json
from .flat import Literal, Node, Reference, Role, Type, Variable, walk
from .interpreter import Value, evaluate
from .node_arrays import element_name
from .sources import Location

_VARIABLE_READ = frozenset(
    "name source_span type_id variability causality dims start fixed min max nominal quantity unit "
    "display_unit description state_select binding is_protected".split()
)
_VARIABLE_FALSE = frozenset(
    "stream from_expandable_connector is_overconstrained oc_record_path oc_eq_constraint_size".split()
)
_VARIABLE_REDUNDANT = frozenset(
    "instance_id component_ref flow connected binding_from_modification evaluate evaluate_refused "
    "is_discrete_type is_primitive".split()
)


def declared_shapes(flat: Json) -> dict[str, tuple[int, ...]]:
    """Dimensions of every variable of Real, Integer or Boolean type, by name."""
    return {
        name: tuple(int(length) for length in body["dims"])
        for name, body in flat["variables"].items()
        if _type(flat, body) is not None
    }


def declared_integers(flat: Json) -> dict[str, Json]:
    """Expression of the value of every scalar Integer parameter and constant, by name."""
    return {
        name: body["binding"] or body["start"]
        for name, body in flat["variables"].items()
        if _type(flat, body) is Type.INTEGER
        and _keyword(body["variability"]) in ("Parameter", "Constant")
        and not body["dims"]
        and (body["binding"] or body["start"])
    }


def structural_names(flat: Json) -> set[str]:
    """Parameters whose value the compiler has used to choose equations, such as the size of an array."""
    return {
        ".".join(reference)
        for selection in flat.get("parameter_branch_selections", ())
        for reference in selection["references"]
    }


def read_variables(
    flat: Json, expressions: ExpressionReader, place: Callable[[Json], Location]
) -> list[tuple[Variable, Node | None]]:
    """Read every declaration.

    Args:
        flat: the flat representation.
        expressions: reads the expressions in it.
        place: span of the representation -> line of the source.
    Returns: scalar variables in order of declaration, each with the value that its declaration gives
        it as an equation, if any.
    Raises: BuildError for a type, attribute or prefix that is not supported.
    """
    reader = _VariableReader(flat, expressions, place)
    found = [pair for name, body in flat["variables"].items() for pair in reader.variable(name, body)]
    for variable, binding in found:
        if binding is not None and variable.role is Role.INPUT:
            raise BuildError(
                f"{variable.location}: the input {variable.name} has a value of its own; give it as start"
            )
    return found


def fix_structural(variables: Sequence[Variable], used: Set[str]) -> tuple[list[Variable], tuple[str, ...]]:
    """Make parameters final whose value decides which equations there are, and what they are made of.

    Another value would need another set of equations, so nobody may set them.

    Args:
        variables: the declared variables.
        used: names of the parameters whose value was used.
    Returns: the variables, and the names of the parameters concerned in order of declaration.
    """
    bindings = {variable.name: variable.binding for variable in variables if variable.binding is not None}
    found = {name for name in bindings if name in used or name.partition("[")[0] in used}
    queue = sorted(found)
    while queue:
        binding = bindings[queue.pop()]
        for node in walk(binding) if binding is not None else ():
            if isinstance(node, Reference) and node.name in bindings and node.name not in found:
                found.add(node.name)
                queue.append(node.name)
    fixed = [replace(item, final=True) if item.name in found else item for item in variables]
    parameters = {variable.name for variable in variables if variable.role is Role.PARAMETER}
    return fixed, tuple(name for name in bindings if name in found & parameters)


def _type(flat: Json, body: Json) -> Type | None:
    effective = flat["effective_types"][str(body["type_id"])]
    number = effective["canonical_type"]
    predefined = flat["predefined_types"]
    return {
        predefined["real"]: Type.REAL,
        predefined["integer"]: Type.INTEGER,
        predefined["boolean"]: Type.BOOLEAN,
    }.get(number)


def _keyword(value: Any) -> str:
    return value if isinstance(value, str) else next(iter(value))


def _text(value: str | Sequence[str] | None, index: tuple[int, ...]) -> str:
    """An attribute's text for one element; a list gives it element by element."""
    if value is None or isinstance(value, str):
        return value or ""
    return value[index[0]]


class _Defaults(dict[str, Value]):
    """Values of scalar parameters and constants as declared, each evaluated when it is asked for."""

    def __init__(self, flat: Json, expressions: ExpressionReader, where: Location) -> None:
        super().__init__()
        self._flat, self._expressions, self._where = flat, expressions, where

    def __missing__(self, name: str) -> Value:
        body = self._flat["variables"].get(name)
        if body is None or body["dims"] or _keyword(body["variability"]) not in ("Parameter", "Constant"):
            raise KeyError(name)
        expression = body["binding"] or body["start"]
        if expression is None:
            raise KeyError(name)
        self[name] = evaluate(self._expressions.read(expression, self._where)[()], self)
        return self[name]


class _VariableReader:
    def __init__(self, flat: Json, expressions: ExpressionReader, place: Callable[[Json], Location]) -> None:
        self._flat = flat
        self._expressions = expressions
        self._place = place

    def variable(self, name: str, body: Json) -> Iterator[tuple[Variable, Node | None]]:
        span = body["source_span"]
        last = name.rpartition(".")[2].partition("[")[0]
        # The span of a declaration ends with the name.
        where = self._place({**span, "start": max(span["start"], span["end"] - len(last.encode()))})
        unknown = set(body) - _VARIABLE_READ - _VARIABLE_FALSE - _VARIABLE_REDUNDANT
        if unknown:
            raise BuildError(
                f"{where}: {name} has the attributes {', '.join(sorted(unknown))}, which are not supported"
            )
        for key in sorted(_VARIABLE_FALSE & body.keys()):
            if body[key]:
                raise BuildError(
                    f"{where}: {name} is declared as {key.removeprefix('is_')}, which is not supported"
                )
        kind = _type(self._flat, body)
        if kind is None or not body["is_primitive"]:
            type_name = self._flat["variable_type_names"].get(name, "unknown")
            raise BuildError(
                f"{where}: {name} has the type {type_name}; only Real, Integer and Boolean are supported"
                + ("" if type_name == "String" else ", use an Integer for an enumeration")
            )
        role = self._role(name, body, where)
        shape = tuple(body["dims"])
        bindings = self._attribute(body["binding"], shape, where)
        starts = self._attribute(body["start"], shape, where)
        fixed = self._fixed(name, body["fixed"], where)
        if role in (Role.CONSTANT, Role.PARAMETER):
            if fixed is False:
                raise BuildError(
                    f"{where}: {name} has fixed=false, which needs initial equations; give it a value"
                )
            bindings = {index: bindings[index] or starts[index] or Literal(0.0) for index in bindings}
        limits = {key: self._attribute(body[key], shape, where) for key in ("min", "max", "nominal")}
        for index in bindings:
            own = element_name(name, index)
            numbers = {key: self._number(own, key, values[index], where) for key, values in limits.items()}
            keeps_binding = role in (Role.CONSTANT, Role.PARAMETER)
            yield (
                Variable(
                    name=own,
                    role=role,
                    type=kind,
                    location=where,
                    binding=bindings[index] if keeps_binding else None,
                    start=None if keeps_binding else starts[index],
                    fixed=bool(fixed),
                    minimum=numbers["min"],
                    maximum=numbers["max"],
                    nominal=numbers["nominal"],
                    unit=_text(body["unit"], index),
                    display_unit=_text(body["display_unit"], index),
                    quantity=_text(body["quantity"], index),
                    description=body["description"] or "",
                    final=bool(self._flat["variable_final_flags"].get(name)),
                    protected=body["is_protected"],
                ),
                None if keeps_binding else bindings[index],
            )

    def _role(self, name: str, body: Json, where: Location) -> Role:
        variability = _keyword(body["variability"])
        causality = _keyword(body["causality"])
        if variability == "Constant":
            return Role.CONSTANT
        if variability == "Parameter":
            return Role.PARAMETER
        if variability not in ("Empty", "Discrete", "Continuous") or causality not in (
            "Empty",
            "Input",
            "Output",
        ):
            raise BuildError(
                f"{where}: {name} is declared {variability.lower()} {causality.lower()}, which is not "
                "supported"
            )
        # A connector's or component's port is an unknown like any other; only the model's own are its ports.
        top = "." not in name or name in self._flat["top_level_input_components"]
        if not top or causality == "Empty":
            return Role.LOCAL
        return Role.INPUT if causality == "Input" else Role.OUTPUT

    def _attribute(
        self, body: Json | None, shape: tuple[int, ...], where: Location
    ) -> dict[tuple[int, ...], Node | None]:
        indices = list(np.ndindex(shape))
        if body is None:
            return dict.fromkeys(indices)
        nodes = self._expressions.read(body, where)
        if nodes.shape not in ((), shape):
            raise BuildError(f"{where}: a value of shape {list(nodes.shape)} is given for {list(shape)}")
        return {index: nodes[index] if nodes.shape else nodes[()] for index in indices}

    def _fixed(self, name: str, value: Any, where: Location) -> bool | None:
        if value is None:
            return None
        values = {entry for entry in value} if isinstance(value, list) else {value}
        if values in ({True}, {False}):
            return values.pop()
        raise BuildError(f"{where}: `fixed` of {name} has to be true or false for all elements, got {value}")

    def _number(self, name: str, attribute: str, node: Node | None, where: Location) -> float | None:
        if node is None:
            return None
        if isinstance(node, Literal):
            return float(node.value)
        try:
            return float(evaluate(node, _Defaults(self._flat, self._expressions, where)))
        except KeyError:
            raise BuildError(
                f"{where}: `{attribute}` of {name} has to be a number; it may depend on parameters only"
            ) from None
