"""Flatten a Modelica model with rumoca and read its intermediate representation, section by section."""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from orchestrator.errors import BuildError

from .audit import audit_flattened, audit_sources, experiment
from .expressions import ExpressionReader, Json, element_name
from .flat import Assertion, Equation, FlatModel, Literal, Node, Operation, Reference, Role, Type, Variable, walk
from .sources import DELAY, Location, SourceTree

# The representation carries no version, so its reader knows one release of the compiler.
RUMOCA_VERSION = "0.10.2"

_READ = {"variables", "equations", "assert_equations", "model_description", "variable_final_flags"}
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
    "is_partial": "a partial model",
}
# Types, instances and names that the sections above already carry.
_REDUNDANT = {
    "predefined_string_declaration", "predefined_types", "effective_types", "enumeration_types", "type_ids_by_def_id",
    "enumeration_type_roots", "record_instances", "record_types", "variable_type_names", "structured_equations",
    "functions", "class_type", "top_level_connectors", "top_level_input_components", "oc_break_edge_scalar_count",
    "enum_literal_ordinals", "instance_relations", "parameter_branch_selections",
}  # fmt: skip
_VARIABLE_READ = {
    "name", "source_span", "type_id", "variability", "causality", "dims", "start", "fixed", "min", "max", "nominal",
    "quantity", "unit", "display_unit", "description", "state_select", "binding", "is_protected",
}  # fmt: skip
_VARIABLE_FALSE = {"stream", "from_expandable_connector", "is_overconstrained", "oc_record_path", "oc_eq_constraint_size"}
_VARIABLE_REDUNDANT = {
    "instance_id", "component_ref", "flow", "connected", "binding_from_modification", "evaluate", "evaluate_refused",
    "is_discrete_type", "is_primitive",
}  # fmt: skip


def read_model(tree: SourceTree, model: str) -> FlatModel:
    """Flatten a model.

    Args:
        tree: its source files.
        model: qualified name.
    Returns: the flat model; every element of the compiler's representation is in it.
    Raises: BuildError naming file and line of whatever is not supported or does not compile.
    """
    used = audit_sources(tree, model)
    flat, files = _compile(tree, model)
    reader = _FlatReader(tree, flat, files)
    result = reader.model(model, experiment(tree.classes[model]))
    audit_flattened(tree, used, set(reader.delay_places()), reader.assert_places())
    return result


def _compile(tree: SourceTree, model: str) -> tuple[Json, dict[int, str]]:
    """Run the compiler; returns its flat representation and the path of each source by its number."""
    try:
        installed = version("rumoca")
    except PackageNotFoundError:
        raise BuildError("Modelica compiler: rumoca is not installed; run `pip install rumoca==0.10.2`") from None
    if installed != RUMOCA_VERSION:
        raise BuildError(
            f"Modelica compiler: rumoca {installed} is installed, its representation is known for {RUMOCA_VERSION} "
            f"only; run `pip install rumoca=={RUMOCA_VERSION}`"
        )
    import rumoca

    with tree.marked_copy() as folder:
        # A session remembers the classes it has seen: one per model.
        session = rumoca.Session(roots=[str(folder)])
        try:
            compiled = session.load(str(folder / tree.main), model=model)
            flat = json.loads(compiled.to_json("flat"))
            files = json.loads(compiled.to_json("dae"))["source_map"]["files"]
        except rumoca.RumocaError as error:
            text = str(error).replace(f"{folder}/", tree.label).replace(DELAY, "delay")
            item = tree.classes[model]
            raise BuildError(
                f"{tree.shown(item.file)}:{item.line}: the Modelica compiler refuses {model}\n"
                + "\n".join(f"  {line}" for line in text.splitlines())
            ) from error
        prefix = f"{folder.as_posix()}/"
        return flat, {number: path.replace("\\", "/").removeprefix(prefix) for number, path, _ in files}


class _FlatReader:
    def __init__(self, tree: SourceTree, flat: Json, files: dict[int, str]) -> None:
        self._tree = tree
        self._flat = flat
        self._files = files
        self._where = Location(tree.shown(tree.main), 1)
        shapes = {
            name: tuple(int(length) for length in variable["dims"])
            for name, variable in flat["variables"].items()
            if self._type(variable) is not None
        }
        self._expressions = ExpressionReader(shapes, self._place)

    def model(self, name: str, experiment: dict[str, float]) -> FlatModel:
        self._check_sections()
        variables: list[Variable] = []
        equations: list[Equation] = []
        for json_name, body in self._flat["variables"].items():
            for variable, binding in self._variables(json_name, body):
                if variable.role in (Role.CONSTANT, Role.PARAMETER):
                    variables.append(variable)
                    continue
                variables.append(variable)
                if binding is not None:
                    if variable.role is Role.INPUT:
                        raise BuildError(
                            f"{variable.location}: the input {variable.name} has a value of its own; give it as start"
                        )
                    equations.append(Equation(Reference(variable.name), binding, variable.location))
        for body in self._flat["equations"]:
            equations.extend(self._equations(body))
        assertions = [self._assertion(body) for body in self._flat["assert_equations"]]
        return FlatModel(
            name=name,
            description=self._flat["model_description"] or "",
            variables=tuple(variables),
            equations=tuple(equations),
            assertions=(*assertions, *_limits(variables, equations)),
            experiment=experiment,
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
        for section, value in flat.items():
            if section in _EMPTY and value:
                raise BuildError(f"{self._first_place(value)}: {_EMPTY[section]} are not supported")
            if section not in _READ and section not in _EMPTY and section not in _REDUNDANT:
                raise BuildError(
                    f"{self._where}: the compiler's representation has a section {section!r} that is not known; "
                    f"use rumoca {RUMOCA_VERSION}"
                )
        for family in flat["structured_equations"]:
            if not family.get("interiors_materialized"):
                raise BuildError(f"{self._first_place(family)}: this for-loop is not unrolled by the compiler")
        if flat["class_type"] not in ("Model", "Block", "Class"):
            raise BuildError(f"{self._where}: a {flat['class_type'].lower()} cannot be translated, only a model or block")

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

    def _type(self, body: Json) -> Type | None:
        effective = self._flat["effective_types"][str(body["type_id"])]
        number = effective["canonical_type"]
        predefined = self._flat["predefined_types"]
        return {predefined["real"]: Type.REAL, predefined["integer"]: Type.INTEGER, predefined["boolean"]: Type.BOOLEAN}.get(number)

    def _variables(self, name: str, body: Json) -> Iterator[tuple[Variable, Node | None]]:
        where = self._place(body["source_span"])
        unknown = set(body) - _VARIABLE_READ - _VARIABLE_FALSE - _VARIABLE_REDUNDANT
        if unknown:
            raise BuildError(f"{where}: {name} has the attributes {', '.join(sorted(unknown))}, which are not supported")
        for key in sorted(_VARIABLE_FALSE & body.keys()):
            if body[key]:
                raise BuildError(f"{where}: {name} is declared as {key.removeprefix('is_')}, which is not supported")
        kind = self._type(body)
        if kind is None or not body["is_primitive"]:
            type_name = self._flat["variable_type_names"].get(name, "unknown")
            raise BuildError(
                f"{where}: {name} has the type {type_name}; only Real, Integer and Boolean are supported"
                + ("" if type_name == "String" else ", use an Integer for an enumeration")
            )
        role = self._role(name, body, where)
        structural = name in self._structural()
        shape = tuple(body["dims"])
        bindings = self._attribute(body["binding"], shape, where)
        starts = self._attribute(body["start"], shape, where)
        fixed = self._fixed(name, body["fixed"], where)
        if role in (Role.CONSTANT, Role.PARAMETER):
            if fixed is False:
                raise BuildError(f"{where}: {name} has fixed=false, which needs initial equations; give it a value")
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
                    unit=body["unit"] or "",
                    display_unit=body["display_unit"] or "",
                    quantity=body["quantity"] or "",
                    description=body["description"] or "",
                    final=bool(self._flat["variable_final_flags"].get(name)) or structural,
                    protected=body["is_protected"],
                ),
                bindings[index],
            )

    def _role(self, name: str, body: Json, where: Location) -> Role:
        variability = _keyword(body["variability"])
        causality = _keyword(body["causality"])
        if variability == "Constant":
            return Role.CONSTANT
        if variability == "Parameter":
            return Role.PARAMETER
        if variability not in ("Empty", "Discrete", "Continuous") or causality not in ("Empty", "Input", "Output"):
            raise BuildError(f"{where}: {name} is declared {variability.lower()} {causality.lower()}, which is not supported")
        # A connector's or component's port is an unknown like any other; only the model's own are its ports.
        top = "." not in name or name in self._flat["top_level_input_components"]
        if not top or causality == "Empty":
            return Role.LOCAL
        return Role.INPUT if causality == "Input" else Role.OUTPUT

    def _structural(self) -> set[str]:
        """Parameters whose value the compiler has used, such as the size of an array."""
        return {
            ".".join(reference)
            for selection in self._flat.get("parameter_branch_selections", ())
            for reference in selection["references"]
        }

    def _attribute(self, body: Json | None, shape: tuple[int, ...], where: Location) -> dict[tuple[int, ...], Node | None]:
        import numpy as np

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
        raise BuildError(f"{where}: `fixed` of {name} has to be true or false for the whole variable, got {value}")

    def _number(self, name: str, attribute: str, node: Node | None, where: Location) -> float | None:
        if node is None:
            return None
        if isinstance(node, Literal):
            return float(node.value)
        from .interpreter import evaluate

        if any(isinstance(part, Reference) for part in walk(node)):
            raise BuildError(f"{where}: `{attribute}` of {name} has to be a number; it cannot depend on a variable")
        return float(evaluate(node, {}))

    def _equations(self, body: Json) -> Iterator[Equation]:
        where = self._place(body["span"])
        unknown = set(body) - {"residual", "span", "origin", "scalar_count"}
        if unknown:
            raise BuildError(f"{where}: the compiler describes this equation by {', '.join(sorted(unknown))}, which is not supported")
        residual = body["residual"]
        if "Binary" in residual and residual["Binary"]["op"] == "Sub":
            left = self._expressions.read(residual["Binary"]["lhs"], where)
            right = self._expressions.read(residual["Binary"]["rhs"], where)
        else:
            left = self._expressions.read(residual, where)
            right = self._expressions.read({"Literal": {"value": {"Real": 0.0}}}, where)
        shape = left.shape or right.shape
        if any(side.shape not in ((), shape) for side in (left, right)):
            raise BuildError(f"{where}: the sides have shapes {list(left.shape)} and {list(right.shape)}")
        import numpy as np

        if body["scalar_count"] != int(np.prod(shape)):
            raise BuildError(
                f"{where}: the compiler counts {body['scalar_count']} scalar equations here, {int(np.prod(shape))} were read"
            )
        for index in np.ndindex(shape):
            yield Equation(left[index if left.shape else ()], right[index if right.shape else ()], where)

    def _assertion(self, body: Json) -> Assertion:
        where = self._place(body["span"])
        unknown = set(body) - {"condition", "message", "level", "span", "origin"}
        if unknown:
            raise BuildError(f"{where}: the compiler describes this assert by {', '.join(sorted(unknown))}, which is not supported")
        level = 2.0 if body["level"] is None else self._level(body["level"], where)
        condition = self._expressions.scalar(body["condition"], where)
        return Assertion(condition, self._message(body["message"], where), level != 1.0, where)

    def _level(self, body: Json, where: Location) -> float:
        node = self._expressions.scalar(body, where)
        if not isinstance(node, Literal):
            raise BuildError(f"{where}: the level of an assert has to be AssertionLevel.warning or AssertionLevel.error")
        return float(node.value)

    def _message(self, body: Json, where: Location) -> str:
        """Text of an assertion; a value in it is shown as the expression it comes from, in brackets."""
        from .flat import render

        match body:
            case {"Literal": {"value": {"String": text}}}:
                return str(text)
            case {"Binary": {"op": "Add", "lhs": left, "rhs": right}}:
                return self._message(left, where) + self._message(right, where)
            case {"StringConversion": {"value": value}}:
                return f"[{render(self._expressions.scalar(value, where))}]"
        raise BuildError(f"{where}: the message of an assert has to be made of strings and String(...) with +")


def _keyword(value: Any) -> str:
    return value if isinstance(value, str) else next(iter(value))


def _limits(variables: list[Variable], equations: list[Equation]) -> Iterator[Assertion]:
    """delay(x, t, t_max) promises t <= t_max; the promise is checked while the model runs."""
    from .flat import Delay, render

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
