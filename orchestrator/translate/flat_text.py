"""The compiler's flat representation as Modelica: one class without components."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Callable, Iterator
from typing import Any

from .flatten import Json
from .hybrid.sections import hidden_section
from .lexer import tokenise
from .rewriting.hidden_sections import Section
from .sources import DELAY, Spans

_SIGNS = {
    "Or": ("or", 1), "And": ("and", 2), "Lt": ("<", 4), "Le": ("<=", 4), "Gt": (">", 4), "Ge": (">=", 4),
    "Eq": ("==", 4), "Neq": ("<>", 4), "Add": ("+", 5), "Sub": ("-", 5), "AddElem": (".+", 5),
    "SubElem": (".-", 5), "Mul": ("*", 6), "Div": ("/", 6), "MulElem": (".*", 6), "DivElem": ("./", 6),
    "Exp": ("^", 8), "ExpElem": (".^", 8),
}  # fmt: skip
_NOT, _SIGN, _LAST = 3, 6, 9
_SPELT = {"NoEvent": "noEvent", "Ndims": "ndims", "InStream": "inStream", "ActualStream": "actualStream",
          "SemiLinear": "semiLinear", "Outerproduct": "outerProduct"}  # fmt: skip
_ATTRIBUTES = ("start", "fixed", "unit", "displayUnit", "min", "max", "nominal")


def flat_modelica(flat: Json, name: str, spans: Spans, function_text: Callable[[str], str]) -> str:
    """The text of a flat model; names of components are quoted identifiers, as 'motor.phi'.

    Args:
        flat: the representation.
        name: of the model.
        spans: places, for what is shown as its source has it.
        function_text: of a function by its name, for those that the compiler does not see as they are.
    """
    return "\n".join(_Printer(flat, spans, function_text).lines(name.rpartition(".")[2])) + "\n"


class _Printer:
    def __init__(self, flat: Json, spans: Spans, function_text: Callable[[str], str]) -> None:
        self._flat = flat
        self._function_text = function_text
        self._spans = spans
        self._in_function = False  # where a dot is that of a record
        self._enumerations: dict[str, list[str]] = {}
        for literal in flat.get("enum_literal_ordinals", {}):
            owner, _, member = literal.rpartition(".")
            if "'" not in literal and owner.rpartition(".")[2] not in ("StateSelect", "AssertionLevel"):
                self._enumerations.setdefault(owner.rpartition(".")[2], [])
                if member not in self._enumerations[owner.rpartition(".")[2]]:
                    self._enumerations[owner.rpartition(".")[2]].append(member)

    def lines(self, name: str) -> Iterator[str]:
        flat = self._flat
        yield f"model {name}"
        used = set(flat.get("variable_type_names", {}).values())
        for kind, members in self._enumerations.items():
            if kind in {one.rpartition(".")[2] for one in used}:
                yield f"  type {kind} = enumeration({', '.join(members)});"
        for function in flat.get("functions", {}).values():
            if function["name"] == DELAY:
                continue
            self._in_function = True
            yield from self._function(function)
            self._in_function = False
        sections = flat.get("sections", {})
        hidden = {one: hidden_section(one, sections) for one in flat["variables"]} if sections else {}
        for one, body in flat["variables"].items():
            if hidden.get(one) is None:
                yield f"  {self._declaration(one, body)}"
        yield from self._section("initial equation", flat["initial_equations"], [])
        yield from self._section("equation", flat["equations"], flat["structured_equations"])
        for chain in flat["when_chains"]:
            yield from self._when(chain)
        for one in flat["assert_equations"]:
            yield f"  assert({self._text(one['condition'])}, {self._text(one['message'])});"
        for key, head in (("algorithms", "algorithm"), ("initial_algorithms", "initial algorithm")):
            for one in flat[key]:
                yield head
                for statement in one["statements"]:
                    yield from self._statement(statement, "  ")
        for found in hidden.values():
            if found is not None:
                yield "initial algorithm" if found[1].initial else "algorithm"
                yield from (f"  {line}" for line in self._renamed(*found).splitlines() if line.strip())
        yield f"end {name};"

    def _renamed(self, owner: str, section: Section) -> str:
        """The text of a section, with the names that its component's variables have in the flat model."""
        text, tokens = section.text.strip(), tokenise(section.text.strip(), section.file)
        place = 0
        edits: list[tuple[int, int, str]] = []
        while place < len(tokens):
            end = place
            while end + 2 < len(tokens) and tokens[end + 1].text == "." and tokens[end + 2].kind == "name":
                end += 2
            path = ".".join(one.text for one in tokens[place : end + 1 : 2])
            full = f"{owner}.{path}" if owner else path
            if tokens[place].kind == "name" and full in self._flat["variables"]:
                last = tokens[end]
                edits.append((tokens[place].start, last.start + len(last.text), quoted(full)))
            place = end + 1
        for start, stop, name in reversed(edits):
            text = text[:start] + name + text[stop:]
        first, _, rest = text.partition("\n")
        return f"{first}\n{textwrap.dedent(rest)}"

    def _declaration(self, name: str, body: Json) -> str:
        words = []
        variability = body["variability"]
        if not isinstance(variability, str):
            words.append(next(iter(variability)).lower())
        if (
            not isinstance(body["causality"], str) and "." not in name
        ):  # of a component it is none of the model
            words.append(next(iter(body["causality"])).lower())
        declared = self._flat.get("variable_type_names", {}).get(name, "Real")
        kind = declared.rpartition(".")[2]
        if kind not in ("Real", "Integer", "Boolean", "String") and kind not in self._enumerations:
            kind = self._basic(body)
        size = f"[{', '.join(map(str, body['dims']))}]" if body.get("dims") else ""
        given = []
        each = "each " if size else ""
        for attribute in _ATTRIBUTES:
            value = body.get({"displayUnit": "display_unit"}.get(attribute, attribute))
            if value in (None, [], {}, ""):
                continue
            if attribute == "start" and (
                not self._declares_start(body) or words[:1] in (["parameter"], ["constant"])
            ):
                continue
            if isinstance(value, str):
                given.append(f'{each}{attribute} = "{value}"')
            elif attribute == "fixed":
                flags = value if isinstance(value, list) else [value]
                if len(set(flags)) == 1:
                    given.append(f"{each}fixed = {str(flags[0]).lower()}")
            elif isinstance(value, dict):
                text = self._text(value)
                given.append(f"{'' if text.startswith(('{', 'fill(')) else each}{attribute} = {text}")
        modifiers = f"({', '.join(given)})" if given else ""
        binding = f" = {self._text(body['binding'])}" if body.get("binding") else ""
        comment = f' "{body["description"]}"' if isinstance(body.get("description"), str) else ""
        return f"{' '.join([*words, kind])} {quoted(name)}{size}{modifiers}{binding}{comment};"

    @staticmethod
    def _declares_start(body: Json) -> bool:
        """Whether a start value is the model's, not one that the compiler puts in."""
        inner = next(iter(body["start"].values()))
        return not isinstance(inner, dict) or inner.get("span") != body.get("source_span")

    def _basic(self, body: Json) -> str:
        kinds = self._flat["effective_types"].get(str(body["type_id"]), {})
        names = {number: kind.capitalize() for kind, number in self._flat["predefined_types"].items()}
        return names.get(kinds.get("canonical_type"), "Real")

    def _section(self, head: str, equations: list[Json], families: list[Json]) -> Iterator[str]:
        if not equations and head != "equation":
            return
        yield head
        loops: dict[int, Json | None] = {}
        for family in families:
            template = family.get("template") or {}
            # An equation of arrays stands for itself.
            if not template.get("body") or template.get("scalar_view") == "RowMajorProjection":
                continue
            numbers = equations_of(family)
            loops |= dict.fromkeys(numbers)
            loops[numbers.start] = family
        for number, one in enumerate(equations):
            if number not in loops:
                yield f"  {self._equation(one['residual'])};"
            elif (family := loops[number]) is not None:
                heads = []
                for binder in family["domain"]["binders"]:
                    step = f"{binder['step']}:" if binder["step"] != 1 else ""
                    heads.append(f"{binder['display_name']} in {binder['lower']}:{step}{binder['upper']}")
                yield f"  for {', '.join(heads)} loop"
                for residual in family["template"]["body"]:
                    yield f"    {self._equation(residual)};"
                yield "  end for;"

    def _equation(self, residual: Json) -> str:
        binary = residual.get("Binary")
        if binary and binary["op"] in ("Sub", "SubElem"):
            return f"{self._text(binary['lhs'], _NOT)} = {self._text(binary['rhs'])}"
        return f"0 = {self._text(residual)}"

    def _when(self, chain: Json) -> Iterator[str]:
        for word, part in (("when", chain["first"]), *(("elsewhen", one) for one in chain["else_when"])):
            yield f"  {word} {self._text(part['condition'])} then"
            for one in part["equations"]:
                yield f"    {self._effect(one)};"
        yield "  end when;"

    def _effect(self, json: Json) -> str:
        ((kind, body),) = json.items()
        match kind:
            case "Assign":
                return f"{quoted(body['target'])} = {self._text(body['value'])}"
            case "Reinit":
                return f"reinit({quoted(body['state'])}, {self._text(body['value'])})"
            case "Assert" if "condition" in body:
                return f"assert({self._text(body['condition'])}, {self._text(body['message'])})"
            case "Terminate" if "message" in body:
                return f"terminate({self._text(body['message'])})"
        return self._source(body)

    def _function(self, function: Json) -> Iterator[str]:
        name = function["name"].rpartition(".")[2]
        if function.get("is_constructor"):
            yield f"  record {name}"
            for one in function["inputs"]:
                yield f"    {one['type_name'].rpartition('.')[2]} {one['name']};"
            yield f"  end {name};"
            return
        if function.get("external") and (text := self._function_text(function["name"])):
            yield from (f"  {line}" for line in textwrap.dedent(f"  {text.strip()}").splitlines())
            return
        yield f"  function {name}"
        for word, key in (("input ", "inputs"), ("output ", "outputs"), ("", "locals")):
            if word == "" and function[key]:
                yield "  protected"
            for one in function[key]:
                default = f" = {self._text(one['default'])}" if one.get("default") else ""
                sizes = [self._subscript(each) for each in one["shape_expr"]]
                size = f"[{', '.join(sizes)}]" if sizes else ""
                yield f"    {word}{one['type_name'].rpartition('.')[2]} {one['name']}{size}{default};"
        if function.get("external"):
            yield f"  external; // {self._source(function['external'])}"
        else:
            yield "  algorithm"
            for one in function["body"]:
                yield from self._statement(one, "    ")
        yield f"  end {name};"

    def _statement(self, json: Json, indent: str) -> Iterator[str]:
        if not isinstance(json, dict):
            yield f"{indent}{str(json).lower()};"  # return and break
            return
        ((kind, body),) = json.items()
        match kind:
            case "Assignment":
                parts = []
                for part in body["comp"]["parts"]:
                    subs = [self._subscript(one) for one in part["subs"]]
                    parts.append(part["ident"] + (f"[{', '.join(subs)}]" if subs else ""))
                name = ".".join(parts)
                plain = "[" in name or self._in_function
                yield f"{indent}{name if plain else quoted(name)} := {self._text(body['value'])};"
            case "For" if "equations" in body:
                binders = [f"{one['ident']} in {self._text(one['range'])}" for one in body["indices"]]
                yield f"{indent}for {', '.join(binders)} loop"
                yield from self._nested(body["equations"], indent)
                yield f"{indent}end for;"
            case "If" | "When" if "cond_blocks" in body or "blocks" in body:
                word = kind.lower()
                for number, one in enumerate(body.get("cond_blocks") or body["blocks"]):
                    yield f"{indent}{'else' if number else ''}{word} {self._text(one['cond'])} then"
                    yield from self._nested(one["stmts"], indent)
                if body.get("else_block"):
                    yield f"{indent}else"
                    yield from self._nested(body["else_block"], indent)
                yield f"{indent}end {word};"
            case "While" if {"cond", "stmts"} <= body.keys():
                yield f"{indent}while {self._text(body['cond'])} loop"
                yield from self._nested(body["stmts"], indent)
                yield f"{indent}end while;"
            case "Assert":
                yield f"{indent}assert({self._text(body['condition'])}, {self._text(body['message'])});"
            case _:
                for line in self._source(body).splitlines():
                    yield f"{indent}// {kind.lower()}: {line.strip()}"

    def _nested(self, statements: list[Json], indent: str) -> Iterator[str]:
        for one in statements:
            yield from self._statement(one, f"{indent}  ")

    def _source(self, body: Any) -> str:
        """What the source has at a span."""
        span = body.get("span") if isinstance(body, dict) else None
        _, text = self._spans.files.get((span or {}).get("source", 0), ("", ""))
        return text.encode()[span["start"] : span["end"]].decode() if span and text else "/* not shown */"

    def _text(self, json: Any, level: int = 0) -> str:
        if not isinstance(json, dict) or len(json) != 1:
            return "/* not shown */"
        ((kind, body),) = json.items()
        match kind:
            case "Literal":
                return _literal(body["value"])
            case "VarRef":
                subs = [self._subscript(one) for one in body["subscripts"]]
                return self._name(body["name"]["name"]) + (f"[{', '.join(subs)}]" if subs else "")
            case "Unary":
                word, own = (
                    ("not ", _NOT) if body["op"] == "Not" else ("-" if "Minus" in body["op"] else "+", _SIGN)
                )
                return _within(f"{word}{self._text(body['rhs'], own + 1)}", own, level + (own == _SIGN))
            case "Binary" if body["op"] in _SIGNS:
                sign, own = _SIGNS[body["op"]]
                blank = "" if own >= 6 else " "
                left = self._text(body["lhs"], own + (own in (4, 8)))
                right = self._text(body["rhs"], own + (own > 2))
                return _within(f"{left}{blank}{sign}{blank}{right}", own, level)
            case "If":
                branches = [
                    f"{'else' if n else ''}if {self._text(c)} then {self._text(v)}"
                    for n, (c, v) in enumerate(body["branches"])
                ]
                return _within(f"{' '.join(branches)} else {self._text(body['else_branch'])}", 0, level)
            case "Array" if body.get("kind") == "Vertical":
                rows = [one["Array"]["elements"] if "Array" in one else [one] for one in body["elements"]]
                return f"[{'; '.join(', '.join(map(self._text, row)) for row in rows)}]"
            case "Array" if body.get("kind") == "Horizontal":
                return f"[{', '.join(map(self._text, body['elements']))}]"
            case "Index" if {"base", "subscripts"} <= body.keys():
                subs = ", ".join(map(self._subscript, body["subscripts"]))
                return f"{self._text(body['base'], _LAST)}[{subs}]"
            case "Array" if "elements" in body:
                return f"{{{', '.join(map(self._text, body['elements']))}}}"
            case "ArrayComprehension" if not body.get("filter"):
                over = [f"{one['name']} in {self._text(one['range'])}" for one in body["indices"]]
                return f"{{{self._text(body['expr'])} for {', '.join(over)}}}"
            case "Tuple" if "elements" in body:
                return f"({', '.join(map(self._text, body['elements']))})"
            case "BuiltinCall":
                name = _SPELT.get(body["function"], body["function"].lower())
                return f"{name}({', '.join(map(self._text, body['args']))})"
            case "FunctionCall" if "args" in body and isinstance(body.get("name"), dict):
                name = body["name"]["name"].replace(DELAY, "delay")
                arguments = [self._text(one) for one in body["args"]]
                if name == "delay" and arguments[2:] == ["-1"]:
                    arguments.pop()  # put in for the compiler
                return f"{name.rpartition('.')[2]}({', '.join(arguments)})"
            case "StringConversion":
                return f"String({self._text(body['value'])})"
            case "Range" if {"start", "end"} <= body.keys():
                step = f"{self._text(body['step'])}:" if body.get("step") else ""
                return f"{self._text(body['start'], 5)}:{step}{self._text(body['end'], 5)}"
        return self._source(body)

    def _name(self, name: str) -> str:
        owner, _, member = name.rpartition(".")
        kind = owner.rpartition(".")[2]
        if kind in ("StateSelect", "AssertionLevel") or member in self._enumerations.get(kind, ()):
            return f"{kind}.{member}"
        return name if self._in_function else quoted(name)

    def _subscript(self, json: Json) -> str:
        if "Index" in json:
            return str(json["Index"]["value"])
        return self._text(json["Expr"]["expr"]) if "Expr" in json else ":"


def equations_of(family: Json) -> range:
    """Numbers of the equations that a loop stands for."""
    points = math.prod(len(_values(one)) for one in family["domain"]["binders"])
    first = family["first_equation_index"]
    return range(first, first + points * family["equations_per_point"])


def _values(binder: Json) -> range:
    step = binder["step"]
    return range(binder["lower"], binder["upper"] + (1 if step > 0 else -1), step)


def _within(text: str, own: int, level: int) -> str:
    return f"({text})" if own < level else text


def quoted(name: str) -> str:
    """A name as one identifier: that of a component's variable is quoted."""
    return name if re.fullmatch(r"\w+|'.*'", name) else f"'{name}'"


def _literal(value: Json) -> str:
    ((kind, number),) = value.items()
    if kind == "Boolean":
        return str(bool(number)).lower()
    if kind == "String":
        text = str(number).replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
        return f'"{text}"'
    return f"{number:g}" if kind == "Real" and float(f"{number:g}") == number else str(number)
