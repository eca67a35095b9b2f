"""Read the compiler's flat representation of a model, section by section; nothing is passed over."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np

from orchestrator.base.errors import BuildError

from .audit import audit_flattened, audit_sources, experiment
from .declarations import (
    declared_integers,
    declared_shapes,
    fix_structural,
    read_variables,
    structural_names,
)
from .expressions import ExpressionReader, Json
from .flat import (
    Assertion,
    Delay,
    Equation,
    FlatModel,
    Literal,
    Operation,
    Reference,
    Variable,
    render,
    walk,
)
from .flatten import RUMOCA_VERSION, flatten
from .rewriting.component_arrays import refuse_single_components
from .sizes import refuse_other_sizes
from .sources import Location, SourceTree
from .unit_arrays import keep_unit_arrays

_READ = {
    "is_partial",
    "variables",
    "equations",
    "assert_equations",
    "model_description",
    "variable_final_flags",
}
_EMPTY = {
    "initial_equations": "initial equations",
    "initial_structured_equations": "initial equations",
    "initial_assert_equations": "assertions on initialisation",
    "algorithms": "algorithm sections",
    "initial_algorithms": "initial algorithms",
    "when_chains": "when-equations",
    "definite_roots": "overconstrained connections",
    "branches": "overconstrained connections",
    "optional_edges": "overconstrained connections",
    "potential_roots": "overconstrained connections",
}
_LOOP = frozenset(
    "domain first_equation_index equations_per_point origin span regular template "
    "interiors_materialized".split()
)
# Types, instances and names that the sections above already carry.
_REDUNDANT = frozenset(
    "predefined_string_declaration predefined_types effective_types enumeration_types type_ids_by_def_id "
    "enumeration_type_roots record_instances record_types variable_type_names structured_equations functions "
    "class_type top_level_connectors top_level_input_components oc_break_edge_scalar_count "
    "enum_literal_ordinals instance_relations parameter_branch_selections".split()
)


def read_model(tree: SourceTree, model: str) -> FlatModel:
    """Flatten a model.

    Args:
        tree: its source files.
        model: qualified name.
    Returns: the flat model; every element of the compiler's representation is in it.
    Raises: BuildError naming file and line of whatever is not supported or does not compile.
    """
    used = audit_sources(tree, model)
    flat, files = flatten(tree, model)
    refuse_other_sizes(tree, {name: body.get("dims") or [] for name, body in flat["variables"].items()})
    refuse_single_components(tree, model, flat["variables"])
    keep_unit_arrays(tree, flat, files)
    reader = _FlatReader(tree, flat, files)
    result = reader.model(model, experiment(tree.classes[model]))
    audit_flattened(tree, used, set(reader.delay_places()), reader.assert_places())
    return result


class _FlatReader:
    def __init__(self, tree: SourceTree, flat: Json, files: dict[int, str]) -> None:
        self._tree = tree
        self._flat = flat
        self._files = files
        self._where = Location(tree.shown(tree.main), 1)
        self._expressions = ExpressionReader(declared_shapes(flat), self._place, declared_integers(flat))

    def model(self, name: str, experiment: dict[str, float]) -> FlatModel:
        self._check_sections()
        variables: list[Variable] = []
        equations: list[Equation] = []
        for variable, binding in read_variables(self._flat, self._expressions, self._place):
            variables.append(variable)
            if binding is not None:
                equations.append(Equation(Reference(variable.name), binding, variable.location))
        unrolled = self._unrolled_loops()
        for number, body in enumerate(self._flat["equations"]):
            if number not in unrolled:
                equations.extend(self._equations(body))
            elif unrolled[number] is not None:
                equations.extend(self._loop(unrolled[number]))
        assertions = [self._assertion(body) for body in self._flat["assert_equations"]]
        variables, structural = fix_structural(
            variables, structural_names(self._flat) | self._expressions.structural
        )
        return FlatModel(
            name=name,
            description=self._flat["model_description"] or "",
            variables=tuple(variables),
            equations=tuple(equations),
            assertions=(*assertions, *_limits(variables, equations)),
            experiment=experiment,
            structural=structural,
        )

    def delay_places(self) -> Iterator[tuple[str, int]]:
        for source, start in self._expressions.delays:
            yield self._files.get(source, ""), start

    def assert_places(self) -> list[tuple[str, int, int]]:
        spans = [body["span"] for body in self._flat["assert_equations"]]
        return [(self._files.get(span["source"], ""), span["start"], span["end"]) for span in spans]

    def _place(self, span: Json) -> Location:
        path = self._files.get(span["source"])
        if path is None or path not in self._tree.texts:
            return Location(path or self._where.file, 1) if path else self._where
        return self._tree.place(path, span["start"])

    def _check_sections(self) -> None:
        flat = self._flat
        if flat["is_partial"]:
            raise BuildError(f"{self._where}: the model is partial; build a model that extends it")
        for section, value in flat.items():
            if section in _EMPTY and value:
                raise BuildError(f"{self._first_place(value)}: {_EMPTY[section]} are not supported")
            if section not in _READ and section not in _EMPTY and section not in _REDUNDANT:
                raise BuildError(
                    f"{self._where}: the compiler's representation has a section {section!r} that is not "
                    "known; "
                    f"use rumoca {RUMOCA_VERSION}"
                )
        if flat["class_type"] not in ("Model", "Block", "Class"):
            raise BuildError(
                f"{self._where}: a {flat['class_type'].lower()} cannot be translated, only a model or block"
            )

    def _first_place(self, value: Any) -> Location:
        queue = [value]
        while queue:
            item = queue.pop(0)
            if isinstance(item, dict):
                if isinstance(item.get("span"), dict):
                    return self._place(item["span"])
                queue.extend(item.values())
            elif isinstance(item, list):
                queue.extend(item)
        return self._where

    def _unrolled_loops(self) -> dict[int, Json | None]:
        """The numbers of equations that stand for a for-loop, the first of each with the loop itself.

        Where the compiler keeps a loop, most of its equations are there in number only (der(x) = 0).
        """
        found: dict[int, Json | None] = {}
        for family in self._flat["structured_equations"]:
            if family.get("interiors_materialized") is True:
                continue
            template = family.get("template") or {}
            if (
                set(family) - _LOOP
                or set(template) != {"body"}
                or len(template["body"]) != family["equations_per_point"]
            ):
                raise BuildError(
                    f"{self._first_place(family)}: the compiler keeps this loop or array equation in a form "
                    "that is not known; write its equations one by one"
                )
            first = family["first_equation_index"]
            count = len(list(_points(family))) * family["equations_per_point"]
            found |= dict.fromkeys(range(first, first + count))
            found[first] = family
        return found

    def _loop(self, family: Json) -> Iterator[Equation]:
        for point in _points(family):
            with self._expressions.loop(point):
                for residual in family["template"]["body"]:
                    yield from self._sides(residual, self._place(family["span"]), None)

    def _equations(self, body: Json) -> Iterator[Equation]:
        where = self._place(body["span"])
        unknown = set(body) - {"residual", "span", "origin", "scalar_count"}
        if unknown:
            raise BuildError(
                f"{where}: the compiler describes this equation by {', '.join(sorted(unknown))}, which is "
                "not supported"
            )
        yield from self._sides(body["residual"], where, body["scalar_count"])

    def _sides(self, residual: Json, where: Location, count: int | None) -> Iterator[Equation]:
        """The scalar equations of left - right = 0; `count` is what the compiler counts."""
        inner = next(iter(residual.values())).get("span")
        if inner is not None and self._files.get(inner["source"]) in self._tree.texts:
            where = self._place(inner)  # of the equation itself, not of the loop around it
        if "Binary" in residual and residual["Binary"]["op"] == "Sub":
            left = self._expressions.read(residual["Binary"]["lhs"], where)
            right = self._expressions.read(residual["Binary"]["rhs"], where)
        else:
            left = self._expressions.read(residual, where)
            right = self._expressions.read({"Literal": {"value": {"Real": 0.0}}}, where)
        shape = left.shape or right.shape
        if any(side.shape not in ((), shape) for side in (left, right)):
            raise BuildError(f"{where}: the sides have shapes {list(left.shape)} and {list(right.shape)}")
        read = int(np.prod(shape))
        if count is not None and count != read:
            raise BuildError(f"{where}: the compiler counts {count} scalar equations here, {read} were read")
        for index in np.ndindex(shape):
            yield Equation(left[index if left.shape else ()], right[index if right.shape else ()], where)

    def _assertion(self, body: Json) -> Assertion:
        where = self._place(body["span"])
        unknown = set(body) - {"condition", "message", "level", "span", "origin"}
        if unknown:
            raise BuildError(
                f"{where}: the compiler describes this assert by {', '.join(sorted(unknown))}, which is "
                "not supported"
            )
        level = 2.0 if body["level"] is None else self._level(body["level"], where)
        condition = self._expressions.scalar(body["condition"], where)
        return Assertion(condition, self._message(body["message"], where), level != 1.0, where)

    def _level(self, body: Json, where: Location) -> float:
        node = self._expressions.scalar(body, where)
        if not isinstance(node, Literal):
            raise BuildError(
                f"{where}: the level of an assert has to be AssertionLevel.warning or AssertionLevel.error"
            )
        return float(node.value)

    def _message(self, body: Json, where: Location) -> str:
        """Text of an assertion; a value in it is shown as the expression it comes from, in brackets."""
        match body:
            case {"Literal": {"value": {"String": text}}}:
                return str(text)
            case {"Binary": {"op": "Add", "lhs": left, "rhs": right}}:
                return self._message(left, where) + self._message(right, where)
            case {"StringConversion": {"value": value}}:
                return f"[{render(self._expressions.scalar(value, where))}]"
        raise BuildError(
            f"{where}: the message of an assert has to be made of strings and String(...) with +"
        )


def _points(family: Json) -> Iterator[dict[str, int]]:
    """Values of a loop's indices, by name, over the whole loop."""
    binders = family["domain"]["binders"]
    ranges = []
    for binder in binders:
        step = binder["step"]
        ranges.append(range(binder["lower"], binder["upper"] + (1 if step > 0 else -1), step))
    for values in product(*ranges):
        yield dict(zip((binder["display_name"] for binder in binders), values, strict=True))


def _limits(variables: list[Variable], equations: list[Equation]) -> Iterator[Assertion]:
    """delay(x, t, t_max) promises t <= t_max; the promise is checked while the model runs."""
    seen = set()
    for equation in equations:
        for side in (equation.left, equation.right):
            for node in walk(side):
                if isinstance(node, Delay) and node.limit is not None and (node.time, node.limit) not in seen:
                    seen.add((node.time, node.limit))
                    yield Assertion(
                        Operation("<=", (node.time, node.limit)),
                        f"delay time {render(node.time)} exceeds its limit {render(node.limit)}",
                        True,
                        node.location,
                    )
