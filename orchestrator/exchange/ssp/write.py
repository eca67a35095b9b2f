"""Configs -> system structure packages.

Values are written in the units of the FMU's variables, and conversions as factors, since most tools that read
parameters and connections do not look at units. Version 1.0 is written, which every tool reads, unless an FMU
needs 2.0 (arrays of FMI 3.0).
"""

from __future__ import annotations

import json
import re
import zipfile
from collections.abc import Iterable, Mapping
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ...base.errors import ConfigError, Problem
from ...base.temporary_folders import scratch_root
from ...base.units import BASE_NAMES, Unit
from ...config import Config
from ...config.files import move_effects
from ...fmi import Kind, ModelDescription, Variable
from ...simulation.run import Prepared, prepare
from ...system.system import Instance
from . import annotations
from .elements import SPACES
from .links import Link, links_of
from .read import MAIN, read_ssp
from .schema import VERSIONS

_TOOL = "orchestrator"
_STAMP = (1980, 1, 1, 0, 0, 0)
_KINDS = {Kind.REAL: "Real", Kind.INTEGER: "Integer", Kind.BOOLEAN: "Boolean", Kind.STRING: "String"}


@dataclass(frozen=True)
class Written:
    """A package that was written.

    Attributes:
        version: of SSP.
        carried: what SSP has no word for, carried in an annotation, which other tools ignore.
        lost: of that, what makes other tools run another system.
        code: files of Python code in it, of effects.
    """

    path: Path
    version: str
    carried: tuple[str, ...]
    lost: tuple[str, ...]
    code: tuple[str, ...]


def write_ssp(
    config: str | Path | Mapping[str, Any] | Config,
    path: Path,
    overrides: Iterable[str] = (),
    version: str | None = None,
) -> Written:
    """Write a system and its FMUs as a system structure package.

    Args:
        config, overrides: as `orchestrator.simulation.run.prepare`.
        path: of the .ssp file.
        version: of SSP, "1.0" or "2.0"; None: 1.0 where that is enough.
    Raises: ConfigError with all problems.
    """
    prepared = prepare(config, overrides)
    arrays = [
        instance.name
        for instance in prepared.system.instances
        if any(variable.elements > 1 for variable in instance.fmu.description.variables.values())
    ]
    if version == "1.0" and arrays:
        what = f"SSP 1.0 has no arrays, which FMUs of {', '.join(arrays)} have"
        raise ConfigError([Problem("", what, "SSP 2.0 has", "Leave the version out.")])
    version = version or ("2.0" if arrays else "1.0")
    if version not in VERSIONS:
        raise ConfigError([Problem("", f"no version {version!r} of SSP", f"versions: {', '.join(VERSIONS)}")])
    writer = _Writer(prepared, version)
    with TemporaryDirectory(prefix="ssp-", dir=scratch_root()) as folder:
        draft, final = Path(folder, "draft.ssp"), Path(folder, "final.ssp")
        writer.pack(draft, None)
        plain = read_ssp(draft, Path(folder, "fmus"))
        data = deepcopy(prepared.config.model.to_data())
        move_effects(data, writer.take_code)
        carried = annotations.collect(data, plain.data, writer.counts, writer.files)
        writer.pack(final, carried)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(final.read_bytes())
    return Written(path, version, _named(carried), tuple(writer.lost), tuple(writer.code))


def _named(carried: Mapping[str, Any]) -> tuple[str, ...]:
    """What is in an annotation and nowhere else in the file, in words."""
    run = carried["run"]
    found = [f"run.{key}" for key in run if key not in ("start_time", "stop_time")]
    for name, one in carried["instances"].items():
        keys = [key for key in one if key not in ("fmu", "start", "interface")]
        found += [f"instances.{name}.{key}" for key in keys]
    for one in carried.get("connections", []):
        entry = one["entry"]
        through = entry.get("through", []) if isinstance(entry, dict) else []
        if any(not {"gain", "offset", "map"} & set(item) for item in through) or not one["plain"]:
            found.append(f"connections[{one['at']}]")
    return (*found, *(key for key in ("bonds", "measures") if carried.get(key)))


class _Writer:
    """Makes the files of a package.

    Attributes:
        counts: how many connections of the file stand for each of the config's.
        files: FMU of each instance.
        lost: what makes other tools run another system.
        code: content of the Python files of effects, by place in the package.
    """

    def __init__(self, prepared: Prepared, version: str) -> None:
        from lxml import etree

        self._etree, self._prepared, self._version = etree, prepared, version
        self.files: dict[str, Path] = {}
        self.code: dict[str, bytes] = {}
        self._descriptions: dict[str, ModelDescription] = {}
        self._places: dict[str, str] = {}
        for instance in prepared.system.instances:
            if instance.name not in prepared.config.model.instances or instance.fmu.path is None:
                what = f"{instance.name} is no FMU"
                raise ConfigError([Problem(prepared.config.name, what, "SSP knows systems of FMUs only")])
            self.files[instance.name] = Path(instance.fmu.path)
            self._descriptions[instance.name] = instance.fmu.description
        self._place_files()
        self._links, self.lost = links_of(prepared, self._descriptions)
        self.counts = [len(links) for links in self._links]

    def _place_files(self) -> None:
        """A path in the package for each FMU, one for instances of the same, and for each instance's values.

        No two paths differ in case only: on Windows and macOS they would name one file.
        """
        taken: dict[str, tuple[str, str]] = {}
        for name, file in self.files.items():
            total = annotations.checksum(file)
            stem = re.sub(r"[^A-Za-z0-9_.-]", "_", file.stem)
            place, number = f"resources/{stem}.fmu", 2
            while taken.get(place.casefold(), (total, place)) != (total, place):
                place, number = f"resources/{stem}-{number}.fmu", number + 1
            taken[place.casefold()] = (total, place)
            self._places[name] = place
        self._values: dict[str, str] = {}
        used: set[str] = set()
        for one in self._prepared.system.instances:
            place, number = f"resources/{one.name}.ssv", 2
            while place.casefold() in used:
                place, number = f"resources/{one.name}-{number}.ssv", number + 1
            used.add(place.casefold())
            self._values[one.name] = place

    def take_code(self, file: str) -> str:
        """Take a Python file into the package. Returns: its place there."""
        path = self._prepared.config.folder / file
        content, place, number = path.read_bytes(), f"resources/{path.name}", 2
        while self.code.get(place, content) != content:
            place, number = f"resources/{path.stem}-{number}.py", number + 1
        self.code[place] = content
        return place

    def pack(self, path: Path, carried: Mapping[str, Any] | None) -> None:
        """Write the archive. `carried`: for our annotation."""
        content = {MAIN: self._document(carried)}
        for instance in self._prepared.system.instances:
            if instance.start:
                content[self._values[instance.name]] = self._parameters(instance)
        content |= self.code
        with zipfile.ZipFile(path, "w") as archive:
            for name, data in content.items():
                _add(archive, name, data, zipfile.ZIP_DEFLATED)
            for name, place in {place: file for file, place in self._places.items()}.items():
                _add(archive, name, self.files[place].read_bytes(), zipfile.ZIP_STORED)

    def _node(self, parent: Any, tag: str, /, **attributes: str | None) -> Any:
        space, _, local = tag.partition(":")
        full = f"{{{SPACES[space]}}}{local}"
        given = {key: text for key, text in attributes.items() if text is not None}
        if parent is not None:
            return self._etree.SubElement(parent, full, given)
        spaces = {space: SPACES[space], "ssc": SPACES["ssc"]}
        if space == "ssd":
            # At the root: libcosim takes a declaration within for an algorithm.
            spaces |= {"osp": annotations.OSP, "orchestrator": annotations.SPACE}
        return self._etree.Element(full, given, nsmap=spaces)

    def _bytes(self, root: Any) -> bytes:
        return self._etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)

    def _document(self, carried: Mapping[str, Any] | None) -> bytes:
        prepared, model = self._prepared, self._prepared.config.model
        root = self._node(
            None, "ssd:SystemStructureDescription",
            version=self._version, name=prepared.config.name, generationTool=_TOOL,
        )  # fmt: skip
        title = model.title or None
        system = self._node(root, "ssd:System", name=prepared.config.name, description=title)
        inner = self._node(system, "ssd:Elements")
        units: dict[str, Unit] = {}
        enumerations: dict[str, Mapping[str, int]] = {}
        fed = {str(one.target) for one in prepared.system.connections}
        for instance in prepared.system.instances:
            self._component(inner, instance, fed, units, enumerations)
        links = [link for entry in self._links for link in entry]
        if links:
            outer = self._node(system, "ssd:Connections")
            for link in links:
                self._link(outer, link)
        self._definitions(root, "ssd", units, enumerations)
        begin, end, step = model.run.times()
        experiment = self._node(
            root, "ssd:DefaultExperiment", startTime=_decimal(float(begin)), stopTime=_decimal(float(end))
        )
        self._osp(experiment, float(step))
        if carried is not None:
            holder = self._node(root, "ssd:Annotations")
            note = self._node(holder, "ssc:Annotation", type=annotations.TYPE)
            own = self._etree.SubElement(note, f"{{{annotations.SPACE}}}Config")
            own.text = json.dumps(carried, ensure_ascii=False)
        return self._bytes(root)

    def _osp(self, experiment: Any, step: float) -> None:
        """The step size for libcosim, which does not run a package without."""
        note = self._node(
            self._node(experiment, "ssd:Annotations"), "ssc:Annotation", type=annotations.OSP_TYPE
        )
        algorithm = self._etree.SubElement(note, f"{{{annotations.OSP}}}Algorithm")
        self._etree.SubElement(
            algorithm, f"{{{annotations.OSP}}}FixedStepAlgorithm", {"baseStepSize": _decimal(step)}
        )

    def _component(
        self,
        parent: Any,
        instance: Instance,
        fed: set[str],
        units: dict[str, Unit],
        enumerations: dict[str, Mapping[str, int]],
    ) -> None:
        model = self._prepared.config.model.instances[instance.name]
        implementation = {"co-simulation": "CoSimulation", "model-exchange": "ModelExchange"}
        node = self._node(
            parent, "ssd:Component", name=instance.name, type="application/x-fmu-sharedlibrary",
            source=self._places[instance.name], implementation=implementation.get(model.interface or ""),
        )  # fmt: skip
        description = instance.fmu.description
        ports = [one for one in description.inputs if f"{instance.name}.{one.name}" in fed]
        ports += [one for one in description.outputs if not one.shape]
        arrays: dict[str, list[Variable]] = {}
        for one in ports:
            arrays.setdefault(one.name.rpartition("[")[0] if one.elements > 1 else one.name, []).append(one)
        if arrays:
            holder = self._node(node, "ssd:Connectors")
            for name, variables in arrays.items():
                one = variables[0]
                kind = "input" if one in description.inputs else "output"
                connector = self._node(holder, "ssd:Connector", name=name, kind=kind)
                self._typed(connector, instance.name, one, units, enumerations)
                for size in self._shape(description, name) if one.elements > 1 else ():
                    self._node(connector, "ssc:Dimension", size=str(size))
        if instance.start:
            bindings = self._node(node, "ssd:ParameterBindings")
            self._node(bindings, "ssd:ParameterBinding", source=self._values[instance.name])

    @staticmethod
    def _shape(description: ModelDescription, name: str) -> list[int]:
        """Dimensions of an array, from the indices of its last element."""
        last = [one for one in description.variables if one.startswith(f"{name}[")][-1]
        return [int(text) for text in last[len(name) + 1 : -1].split(",")]

    def _typed(
        self,
        parent: Any,
        instance: str,
        variable: Variable,
        units: dict[str, Unit],
        enumerations: dict[str, Mapping[str, int]],
    ) -> None:
        if variable.kind is Kind.ENUMERATION and variable.items:
            name = f"{instance}.{variable.name}"
            enumerations[name] = variable.items
            self._node(parent, "ssc:Enumeration", name=name)
            return
        unit = None
        if variable.unit is not None and variable.unit_name:
            unit = _unit_name(units, variable.unit_name, variable.unit)
        self._node(parent, f"ssc:{_KINDS.get(variable.kind, 'Integer')}", unit=unit)

    def _definitions(
        self, root: Any, space: str, units: Mapping[str, Unit], enumerations: Mapping[str, Mapping[str, int]]
    ) -> None:
        if enumerations:
            holder = self._node(root, f"{space}:Enumerations")
            for name, items in enumerations.items():
                one = self._node(holder, "ssc:Enumeration", name=name)
                for item, value in items.items():
                    self._node(one, "ssc:Item", name=item, value=str(value))
        if units:
            holder = self._node(root, f"{space}:Units")
            for name, unit in units.items():
                base = {
                    key: str(power) for key, power in zip(BASE_NAMES, unit.exponents, strict=True) if power
                }
                if unit.factor != 1:
                    base["factor"] = _decimal(float(unit.factor))
                if unit.offset:
                    base["offset"] = _decimal(float(unit.offset))
                self._node(self._node(holder, "ssc:Unit", name=name), "ssc:BaseUnit", **base)

    def _parameters(self, instance: Instance) -> bytes:
        """The .ssv file of an instance's start values."""
        root = self._node(None, "ssv:ParameterSet", version=self._version, name="start")
        holder = self._node(root, "ssv:Parameters")
        units: dict[str, Unit] = {}
        done: set[str] = set()
        for name, value in instance.start.items():
            variable = instance.variable(name)
            if variable.elements > 1:
                array = name.rpartition("[")[0]
                if array not in done:
                    done.add(array)
                    self._array(holder, instance, array, units)
                continue
            parameter = self._node(holder, "ssv:Parameter", name=name)
            self._value(parameter, variable, _text(variable, value), units)
        self._definitions(root, "ssv", units, {})
        return self._bytes(root)

    def _array(self, parent: Any, instance: Instance, name: str, units: dict[str, Unit]) -> None:
        """All elements of an array: those that are not given keep the FMU's own start values."""
        description = instance.fmu.description
        members = [one for one in description.variables.values() if one.name.startswith(f"{name}[")]
        texts = []
        for one in members:
            value = instance.start.get(one.name, one.start)
            if value is None:
                what = f"{instance.name}.{one.name} has no start value, but other elements of {name} have"
                raise ConfigError([Problem("", what, "SSP gives whole arrays")])
            texts.append(_text(one, value))
        parameter = self._node(parent, "ssv:Parameter", name=name)
        self._value(parameter, members[0], " ".join(texts), units)
        for size in self._shape(description, name):
            self._node(parameter, "ssc:Dimension", size=str(size))

    def _value(self, parent: Any, variable: Variable, text: str, units: dict[str, Unit]) -> None:
        kind, unit = _KINDS.get(variable.kind, "Integer"), None
        if variable.kind is Kind.ENUMERATION and not text.lstrip("+-").isdecimal():
            kind = "Enumeration"
        if variable.kind is Kind.REAL and variable.unit is not None and variable.unit_name:
            unit = _unit_name(units, variable.unit_name, variable.unit)
        self._node(parent, f"ssv:{kind}", value=text, unit=unit)

    def _link(self, parent: Any, link: Link) -> None:
        ends: dict[str, str | None] = {}
        indices: dict[str, str | None] = {}
        for side, port, variable in (
            ("start", link.connection.source, link.source),
            ("end", link.connection.target, link.target),
        ):
            name, bracket, inside = port.variable.rpartition("[")
            array = variable.elements > 1
            ends |= {f"{side}Element": port.instance, f"{side}Connector": name if array else port.variable}
            if array and bracket:
                indices[f"{side}Indices"] = inside[:-1].replace(",", " ")
        suppress = "true" if link.suppress else None
        node = self._node(parent, "ssd:Connection", **ends, **indices, suppressUnitConversion=suppress)
        if link.table is not None:
            boolean = link.source.kind is Kind.BOOLEAN and link.target.kind is Kind.BOOLEAN
            name = "BooleanMappingTransformation" if boolean else "IntegerMappingTransformation"
            holder = self._node(node, f"ssc:{name}")
            for before, after in link.table:
                texts = [str(bool(one)).lower() if boolean else str(int(one)) for one in (before, after)]
                self._node(holder, "ssc:MapEntry", source=texts[0], target=texts[1])
        elif (link.factor, link.offset) != (1.0, 0.0) or link.suppress:
            factor, offset = _decimal(link.factor), _decimal(link.offset)
            self._node(node, "ssc:LinearTransformation", factor=factor, offset=offset)


def _add(archive: zipfile.ZipFile, name: str, data: bytes, method: int) -> None:
    entry = zipfile.ZipInfo(name, _STAMP)
    entry.compress_type = method
    entry.external_attr = 0o644 << 16
    archive.writestr(entry, data)


def _unit_name(units: dict[str, Unit], name: str, unit: Unit) -> str:
    """The name of a unit in a file, where each means one thing."""
    free, number = name, 2
    while units.setdefault(free, unit) != unit:
        free, number = f"{name} ({number})", number + 1
    return free


def _decimal(value: float) -> str:
    return f"{int(value)}" if value == int(value) and abs(value) < 1e15 else repr(value)


def _text(variable: Variable, value: Any) -> str:
    """A start value as XML has it."""
    if variable.kind is Kind.BOOLEAN:
        return "true" if value else "false"
    if variable.kind is Kind.REAL:
        return repr(float(value)) if str(float(value)) == "-0.0" else _decimal(float(value))
    if variable.kind is Kind.ENUMERATION:
        return next((item for item, number in variable.items.items() if number == value), str(value))
    return str(value)
