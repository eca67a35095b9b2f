"""What stands in .ssd, .ssv and .ssm files -> plain objects, with the line of each for messages.

Elements and attributes are those of SSP 1.0 and 2.0, whose namespaces are the same. What SSP does not define
is a problem, since it may be what the author relied on; annotations of other tools and what is only drawn is
left alone. Beside that fmpy's schemas judge files of version 1.0, as notes: files of known tools break them
without harm.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction
from typing import Any

from ...base.errors import ConfigError, FmuError, Problem, listed
from ...base.units import BASE_NAMES, Unit, UnitError, parse_unit
from ...fmi.safe_xml import parse_markup
from .elements import SPACES, children, local, schema_errors, space_of, tag_of
from .model import (
    Binding,
    Connection,
    Connector,
    Dictionary,
    Document,
    Element,
    End,
    MappingEntry,
    Parameter,
    Reference,
    Transformation,
)

VERSIONS = ("1.0", "2.0")
_WHOLE = [f"{sign}Int{size}" for size in (8, 16, 32, 64) for sign in ("", "U")]
# SSP's type -> the family of FMI types.
TYPES = {
    **dict.fromkeys(("Real", "Float64", "Float32"), "Real"),
    **dict.fromkeys(("Integer", *_WHOLE), "Integer"),
    **{name: name for name in ("Boolean", "String", "Enumeration", "Binary", "Clock")},
}
_TRANSFORMATIONS = {
    "LinearTransformation": "linear",
    "BooleanMappingTransformation": "boolean",
    "IntegerMappingTransformation": "integer",
    "EnumerationMappingTransformation": "enumeration",
}
# Drawings, and what others attach.
_IDLE = {"Annotations", "ElementGeometry", "SystemGeometry", "GraphicalElements", "ConnectionGeometry",
         "ConnectorGeometry", "MetaData", "Signature"}  # fmt: skip


class Reader:
    """Reads the files of a package; problems and notes are collected.

    Attributes:
        problems, notes: what was found.
    """

    def __init__(self, label: str, problems: list[Problem], notes: list[str]) -> None:
        self._label, self.problems, self.notes = label, problems, notes

    def document(self, name: str, xml: bytes) -> Document:
        """A .ssd file. Raises: ConfigError if it is no XML or no system structure description."""
        root = self._root(name, xml, "ssd", "SystemStructureDescription")
        self._known(name, root, "System", "Enumerations", "Units", "DefaultExperiment")
        units, enumerations = self._units(name, root, "ssd"), self._enumerations(name, root, "ssd")
        systems = children(root, "ssd", "System")
        if len(systems) != 1:
            raise self._refused(name, root, f"it has {len(systems)} root systems", "exactly one is needed")
        experiment = (children(root, "ssd", "DefaultExperiment") or [None])[0]
        annotations = [
            (one.get("type", ""), one)
            for holder in (root, experiment, systems[0])
            if holder is not None
            for one in holder.findall("ssd:Annotations/ssc:Annotation", SPACES)
        ]
        return Document(
            root.get("name", ""),
            root.get("version", ""),
            self._element(name, systems[0], units),
            units,
            enumerations,
            self._time(name, experiment, "startTime"),
            self._time(name, experiment, "stopTime"),
            tuple(annotations),
        )

    def parameters(self, name: str, xml: bytes) -> tuple[Parameter, ...]:
        """A .ssv file. Raises: as `document`."""
        return self._parameter_set(name, self._root(name, xml, "ssv", "ParameterSet"))

    def mapping(self, name: str, xml: bytes) -> tuple[MappingEntry, ...]:
        """A .ssm file. Raises: as `document`."""
        return self._mapping_entries(name, self._root(name, xml, "ssm", "ParameterMapping"))

    def dictionary(self, name: str, xml: bytes) -> dict[str, Connector]:
        """A .ssb file. Raises: as `document`."""
        return self._entries(name, self._root(name, xml, "ssb", "SignalDictionary"))

    def _root(self, name: str, xml: bytes, space: str, wanted: str) -> Any:
        try:
            root = parse_markup(self._label, name, xml, "SSP")
        except FmuError as error:
            raise ConfigError([Problem("", str(error))]) from None
        if root.tag != tag_of(space, wanted):
            what = f"its root element is {root.tag!r}"
            raise self._refused(name, root, what, f"{wanted} of the namespace {SPACES[space]} is needed")
        if root.get("version") not in VERSIONS:
            what = f"it follows version {root.get('version')!r} of SSP"
            raise self._refused(name, root, what, f"versions: {listed(VERSIONS)}")
        if root.get("version") == "1.0":
            broken = schema_errors(root, space)
            if broken:
                more = f" and {len(broken) - 1} more" if broken[1:] else ""
                self.notes.append(
                    f"{self._place(name, root)}: breaks the schema of SSP 1.0: {broken[0]}{more}"
                )
        return root

    def _element(self, name: str, node: Any, units: Mapping[str, Unit]) -> Element:
        what = {"Component": "component", "System": "system"}.get(local(node), "dictionary")
        place = self._place(name, node)
        own = {"component": (), "dictionary": ()}.get(what, ("Elements", "Connections", "SignalDictionaries"))
        self._known(name, node, "Connectors", "ParameterBindings", *own)
        connectors: dict[str, Connector] = {}
        for one in node.findall("ssd:Connectors/ssd:Connector", SPACES):
            connector = self._connector(name, one, units)
            self._once(connector.name, connectors, connector.place, f"connectors of {node.get('name')}")
            connectors[connector.name] = connector
        bindings = [
            self._binding(name, one)
            for one in node.findall("ssd:ParameterBindings/ssd:ParameterBinding", SPACES)
        ]
        common = {
            "what": what,
            "name": self._needs(name, node, "name"),
            "identity": node.get("id", ""),
            "description": node.get("description", ""),
            "connectors": connectors,
            "bindings": tuple(bindings),
            "place": place,
        }
        if what == "dictionary":
            return Element(**common, dictionary=self._needs(name, node, "dictionary"))
        if what == "component":
            source = node.get("source")
            kind = node.get("type", "application/x-fmu-sharedlibrary")
            return Element(
                **common,
                reference=None if source is None else Reference(source, type=kind),
                implementation=node.get("implementation", "any"),
            )
        elements: dict[str, Element] = {}
        for one in node.findall("ssd:Elements/*", SPACES):
            if space_of(one) == "ssd" and local(one) in ("Component", "System", "SignalDictionaryReference"):
                element = self._element(name, one, units)
                self._once(element.name, elements, element.place, f"elements of {node.get('name')}")
                elements[element.name] = element
            elif space_of(one):
                self._unknown(name, one, "Component, System, SignalDictionaryReference")
        return Element(
            **common,
            elements=tuple(elements.values()),
            connections=tuple(
                self._connection(name, one) for one in node.findall("ssd:Connections/ssd:Connection", SPACES)
            ),
            dictionaries=tuple(
                self._signal_dictionary(name, one)
                for one in node.findall("ssd:SignalDictionaries/ssd:SignalDictionary", SPACES)
            ),
        )

    def _connector(self, name: str, node: Any, units: Mapping[str, Unit]) -> Connector:
        place = self._place(name, node)
        typed = [one for one in node if space_of(one) == "ssc" and local(one) in TYPES]
        unit = typed[0].get("unit", "") if typed else ""
        return Connector(
            self._needs(name, node, "name"),
            node.get("kind", ""),
            TYPES[local(typed[0])] if typed else "",
            unit,
            self._unit(name, unit, units),
            bool(node.findall("ssc:Dimension", SPACES)),
            place,
        )

    def _connection(self, name: str, node: Any) -> Connection:
        def end(which: str) -> End:
            indices = node.get(f"{which}Indices", "").replace(",", " ").split()
            return End(
                node.get(f"{which}Element") or None,
                self._needs(name, node, f"{which}Connector"),
                f"[{','.join(indices)}]" if indices else "",
            )

        return Connection(
            end("start"),
            end("end"),
            node.get("suppressUnitConversion") in ("true", "1"),
            self._transformation(name, node),
            self._place(name, node),
        )

    def _transformation(self, name: str, node: Any) -> Transformation | None:
        found = [one for one in node if local(one) in _TRANSFORMATIONS and space_of(one)]
        if not found:
            return None
        one = found[0]
        kind = _TRANSFORMATIONS[local(one)]
        if kind == "linear":
            return Transformation(
                kind, self._number(name, one, "factor", 1.0), self._number(name, one, "offset", 0.0)
            )
        entries: dict[str, str] = {}
        for entry in one.findall("ssc:MapEntry", SPACES):
            source = self._needs(name, entry, "source")
            self._once(source, entries, self._place(name, entry), f"sources of the {kind} mapping")
            entries[source] = self._needs(name, entry, "target")
        return Transformation(kind, entries=entries)

    def _binding(self, name: str, node: Any) -> Binding:
        place = self._place(name, node)
        values: tuple[Parameter, ...] | Reference = ()
        source, kind = node.get("source"), node.get("type", "application/x-ssp-parameter-set")
        inline = node.findall("ssd:ParameterValues/ssv:ParameterSet", SPACES)
        if kind != "application/x-ssp-parameter-set":
            what = f"parameters of type {kind!r}"
            self.problems.append(Problem(place, what, "only application/x-ssp-parameter-set is read"))
        elif source is not None:
            values = Reference(source, node.get("sourceBase", "SSD"))
        elif inline:
            values = tuple(one for item in inline for one in self._parameter_set(name, item))
        else:
            what = "a parameter binding without parameters"
            self.problems.append(Problem(place, what, "a source, or a ParameterSet inside, is needed"))
        mapping: tuple[MappingEntry, ...] | Reference | None = None
        for one in children(node, "ssd", "ParameterMapping"):
            if one.get("source") is not None:
                mapping = Reference(one.get("source"), one.get("sourceBase", "SSD"))
            else:
                inside = one.findall("ssm:ParameterMapping", SPACES)
                mapping = tuple(entry for item in inside for entry in self._mapping_entries(name, item))
        return Binding(values, mapping, node.get("prefix", ""), place)

    def _parameter_set(self, name: str, node: Any) -> tuple[Parameter, ...]:
        units = self._units(name, node, "ssv")
        found: dict[str, Parameter] = {}
        for one in node.findall("ssv:Parameters/ssv:Parameter", SPACES):
            place, title = self._place(name, one), self._needs(name, one, "name")
            typed = [child for child in one if space_of(child) == "ssv" and local(child) in TYPES]
            if len(typed) != 1:
                what = f"parameter {title!r} has {len(typed)} values"
                self.problems.append(Problem(place, what, f"one of {listed(TYPES)} is needed"))
                continue
            value, kind = typed[0], TYPES[local(typed[0])]
            unit = value.get("unit", "")
            many = [item.text or "" for item in value.findall("ssv:Value", SPACES)]
            text = value.get("value")
            if text is None and not many:
                self.problems.append(Problem(place, f"parameter {title!r} has no value"))
                continue
            array = bool(one.findall("ssc:Dimension", SPACES))
            values = many or (text.split() if array and kind != "String" else [text])
            made = Parameter(title, kind, tuple(values), unit, self._unit(name, unit, units), place)
            if title in found and replace(found[title], place=place) == made:
                self.notes.append(f"{place}: parameter {title!r} is given twice, with one value")
                continue
            self._once(title, found, place, "parameters of this set")
            found[title] = made
        return tuple(found.values())

    def _mapping_entries(self, name: str, node: Any) -> tuple[MappingEntry, ...]:
        entries: dict[str, MappingEntry] = {}
        unsourced = 0
        for one in node.findall("ssm:MappingEntry", SPACES):
            target = self._needs(name, one, "target")
            if one.get("source") == "":
                unsourced += 1
                continue
            self._once(target, entries, self._place(name, one), "targets of this mapping")
            suppress = one.get("suppressUnitConversion") in ("true", "1")
            entries[target] = MappingEntry(
                self._needs(name, one, "source"), target, suppress, self._transformation(name, one)
            )
        if unsourced:
            self.notes.append(f"{self._place(name, node)}: {unsourced} entries with an empty source, ignored")
        return tuple(entries.values())

    def _signal_dictionary(self, name: str, node: Any) -> Dictionary:
        place, title = self._place(name, node), self._needs(name, node, "name")
        if node.get("source") is not None:
            return Dictionary(title, Reference(node.get("source")), place)
        inside = node.findall("ssb:SignalDictionary", SPACES)
        return Dictionary(title, self._entries(name, inside[0]) if inside else {}, place)

    def _entries(self, name: str, node: Any) -> dict[str, Connector]:
        units = self._units(name, node, "ssb")
        return {
            one.get("name", ""): self._connector(name, one, units)
            for one in node.findall("ssb:DictionaryEntry", SPACES)
        }

    def _units(self, name: str, node: Any, space: str) -> dict[str, Unit]:
        found: dict[str, Unit] = {}
        for one in node.findall(f"{space}:Units/ssc:Unit", SPACES):
            title = self._needs(name, one, "name")
            base = (children(one, "ssc", "BaseUnit") or [{}])[0]
            try:
                exponents = tuple(int(base.get(key, 0)) for key in BASE_NAMES)
                factor, offset = (
                    Fraction(base.get(key, default)) for key, default in (("factor", 1), ("offset", 0))
                )
            except (ValueError, ZeroDivisionError) as error:
                self.problems.append(Problem(self._place(name, one), f"cannot read unit {title!r} ({error})"))
                continue
            if factor:
                found[title] = Unit(title, exponents, factor, offset)
        return found

    def _unit(self, name: str, title: str, units: Mapping[str, Unit]) -> Unit | None:
        """A unit by its name; one that the file does not define, by what its name says.

        Known tools leave definitions out, or write names in brackets.
        """
        if not title or title in units:
            return units.get(title)
        note = f"{self._label}: {name}: unit {title!r} is not among the file's Units"
        try:
            found = parse_unit(title.strip().removeprefix("[").removesuffix("]"))
            note = f"{note}: read as {found.name} [{found.base()}]"
        except UnitError:
            found = None
        if note not in self.notes:
            self.notes.append(note)
        return found

    def _enumerations(self, name: str, node: Any, space: str) -> dict[str, dict[str, int]]:
        found = {}
        for one in node.findall(f"{space}:Enumerations/ssc:Enumeration", SPACES):
            items = one.findall("ssc:Item", SPACES)
            try:
                found[one.get("name", "")] = {
                    item.get("name", ""): int(item.get("value", "")) for item in items
                }
            except ValueError as error:
                what = f"cannot read enumeration {one.get('name')!r} ({error})"
                self.problems.append(Problem(self._place(name, one), what))
        return found

    def _time(self, name: str, node: Any, key: str) -> str | None:
        text = None if node is None else node.get(key)
        if text is None:
            return None
        self._number(name, node, key, 0.0)
        return text.strip()

    def _number(self, name: str, node: Any, key: str, default: float) -> float:
        text = node.get(key)
        try:
            value = default if text is None else float(text)
            if math.isfinite(value):
                return value
            raise ValueError
        except ValueError:
            self.problems.append(Problem(self._place(name, node), f"{key}: {text!r} is no finite number"))
            return default

    def _known(self, name: str, node: Any, *allowed: str) -> None:
        for one in node:
            if isinstance(one.tag, str) and space_of(one) and local(one) not in (*allowed, *_IDLE):
                self._unknown(name, one, listed(allowed))

    def _unknown(self, name: str, node: Any, allowed: str) -> None:
        what = f"unknown element {local(node)!r}"
        self.problems.append(Problem(self._place(name, node), what, f"allowed: {allowed}"))

    def _needs(self, name: str, node: Any, key: str) -> str:
        text = node.get(key)
        if not text:
            what = f"{local(node)} has no attribute {key!r}"
            self.problems.append(Problem(self._place(name, node), what, "SSP demands it"))
        return text or ""

    def _once(self, name: str, known: Mapping[str, Any], place: str, where: str) -> None:
        if name in known:
            self.problems.append(
                Problem(place, f"two {where} are called {name!r}", "each name may stand once")
            )

    def _place(self, name: str, node: Any) -> str:
        return f"{self._label}: {name}:{node.sourceline}"

    def _refused(self, name: str, node: Any, what: str, allowed: str) -> ConfigError:
        return ConfigError([Problem(self._place(name, node), what, allowed)])
