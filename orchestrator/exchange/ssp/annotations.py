"""What SSP has no word for, carried in an annotation: as the config writes it, beside what the file says.

What stands in the file counts: a part of the annotation is used only where it says the same as the file, so
that a package that another tool has changed is read as changed, with a note.

The annotation (type `orchestrator.config`) holds JSON: `run`, `instances` (per name `fmu`, where it is a
bundled one, `start` as written, and keys that SSP has none for), `connections` (those that are more than one
arrow: `at`, their position, `entry`, as written, and `plain`, what the file says of them), `bonds`,
`measures`, `title`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

from ...base.digests import file_digest
from ...base.units import UnitError, parse_quantity, parse_unit
from ...fmi import ModelDescription, bundled
from ...system.array_start_values import each_element
from .model import Document
from .values import same_start

TYPE = "orchestrator.config"
SPACE = "urn:orchestrator:config:1"
OSP_TYPE = "com.opensimulationplatform"
OSP = "http://opensimulationplatform.com/SSP/OSPAnnotations"
# Of an instance, beside fmu, interface and start, which SSP has words for.
_OWN_KEYS = (
    "form",
    "step_size",
    "feedthrough",
    "tolerance",
    "event_mode",
    "any_step",
    "isolate",
    "time_limit",
)
_TIMES = ("start_time", "stop_time")


def checksum(path: Path) -> str:
    """SHA-256 of a file as it is now: a process that lives long may meet another under the same name."""
    return file_digest(path)


def collect(
    data: Mapping[str, Any], plain: Mapping[str, Any], counts: list[int], files: Mapping[str, Path]
) -> dict[str, Any]:
    """What of a config the file does not say by itself.

    Args:
        data: the config's plain values.
        plain: what is read from the file without annotation.
        counts: how many connections of the file stand for each of the config's.
        files: FMU of each instance.
    """
    instances: dict[str, Any] = {}
    for name, one in data["instances"].items():
        # A path is of no use elsewhere; where the package has the FMU, it says so itself.
        kept = {"fmu": one["fmu"]} if _bundled(one["fmu"], one.get("form"), files[name]) else {}
        kept |= {key: one[key] for key in (*_OWN_KEYS, "interface") if key in one}
        start = one.get("start")
        if start is not None and start != plain["instances"][name].get("start"):
            kept["start"] = start
        instances[name] = kept
    connections, position = [], 0
    for at, (entry, count) in enumerate(zip(data.get("connections", []), counts, strict=True)):
        said = plain["connections"][position : position + count]
        position += count
        if said != [entry]:
            connections.append({"at": at, "entry": entry, "plain": said})
    found: dict[str, Any] = {"run": data["run"], "instances": instances}
    if connections:
        found["connections"] = connections
    if "connections" not in data:
        found["no connections"] = True
    found |= {key: data[key] for key in ("bonds", "measures") if key in data}
    if data.get("title", "") != plain.get("title", "") or "title" in data:
        found["title"] = data.get("title", "")
    return found


def apply(
    data: dict[str, Any],
    document: Document,
    files: Mapping[str, Path],
    descriptions: Mapping[str, ModelDescription],
    notes: list[str],
    label: str,
) -> None:
    """Write into a config what the annotation says, where it agrees with the file.

    Args:
        data: what the file says; changed.
        files, descriptions: FMU of each instance.
        notes: what was left out is added.
        label: of the file, for notes.
    """
    found = [one for kind, one in document.annotations if kind == TYPE]
    if not found:
        return
    try:
        said = json.loads("".join(found[0].itertext()))
        _apply(data, said, files, descriptions, notes, label)
    except (ValueError, TypeError, KeyError, AttributeError, IndexError, RecursionError) as error:
        notes.append(
            f"{label}: its annotation {TYPE} is broken and ignored ({type(error).__name__}: {error})"
        )


def _apply(
    data: dict[str, Any],
    said: Mapping[str, Any],
    files: Mapping[str, Path],
    descriptions: Mapping[str, ModelDescription],
    notes: list[str],
    label: str,
) -> None:
    def other(what: str) -> None:
        notes.append(f"{label}: {what} was changed after the export: the file counts")

    run = dict(said["run"])
    for key in _TIMES:
        own = data["run"].get(key, "0 s" if key == "start_time" else None)
        if own is None or not _same_time(run.get(key, "0 s"), own):
            other(f"run.{key}")
            run.pop(key, None)
            run |= {key: own} if own is not None else {}
    instances = {}
    for name, one in data["instances"].items():
        instances[name] = one
        kept = said["instances"].get(name)
        if kept is None:
            other(f"instance {name}")
            continue
        named = "fmu" in kept and _bundled(kept["fmu"], kept.get("form"), files[name])
        one = {"fmu": kept["fmu"] if named else one["fmu"]} | {
            key: value for key, value in one.items() if key != "fmu"
        }
        for key in _OWN_KEYS:
            if key in kept and (key != "form" or named):
                one[key] = kept[key]
        if "start" in kept:
            one["start"] = _start(name, one.get("start", {}), kept["start"], descriptions[name], other)
        instances[name] = one
    connections = _connections(data["connections"], said.get("connections", []), other)
    rest = {key: said[key] for key in ("bonds", "measures") if key in said}
    title = said.get("title")
    if title is not None and title == data.get("title", ""):
        data["title"] = title
    ordered = {key: data[key] for key in ("title",) if key in data}
    ordered |= {"run": run, "instances": instances, "connections": connections, **rest}
    if said.get("no connections") and not connections:
        del ordered["connections"]
    data.clear()
    data.update(ordered)


def _same_time(one: str, other: str) -> bool:
    try:
        second = parse_unit("s")
        return float(parse_quantity(one).exactly(second)) == float(parse_quantity(other).exactly(second))
    except UnitError:
        return False


def _bundled(name: str, form: str | None, file: Path) -> bool:
    """Whether a bundled FMU goes by that name and is the very file."""
    own = bundled.fmu_forms(name).get(form) if form else bundled.find_fmu(name)
    return own is not None and checksum(own) == checksum(file)


def _start(
    name: str, plain: Mapping[str, Any], written: Mapping[str, Any], description: ModelDescription, other: Any
) -> dict[str, Any]:
    """Start values as written where they are those of the file."""
    found: dict[str, Any] = {}
    whole: set[str] = set()
    for key, value in written.items():
        variable = description.variables.get(key)
        members = () if variable is not None else description.elements(key)
        values = each_element(key, members, value) if members else None
        if values is not None and all(
            one.name in plain and same_start(one, values[one.name], plain[one.name]) for one in members
        ):
            found[key] = value
            whole |= values.keys()
        elif key not in plain or variable is None:
            other(f"{name}.{key}")
        elif same_start(variable, value, plain[key]):
            found[key] = value
        else:
            other(f"{name}.{key}")
            found[key] = plain[key]
    for key, value in plain.items():
        variable = description.variables[key]
        # Of an array the file gives all elements, the config perhaps some.
        if (
            key not in written
            and key not in whole
            and not (variable.elements > 1 and value_of(variable, value))
        ):
            other(f"{name}.{key}")
            found[key] = value
    return found


def value_of(variable: Any, value: Any) -> bool:
    """Whether a start value is the FMU's own."""
    if variable.start is None:
        return False
    unit = f" {variable.unit_name}" if variable.unit_name else ""
    return any(same_start(variable, text, value) for text in (variable.start, f"{variable.start!r}{unit}"))


def _connections(plain: list[Any], special: list[Any], other: Any) -> list[Any]:
    """Entries as written in place of what the file says of them, where it still does."""
    left = list(plain)
    kept: list[tuple[int, Any]] = []
    for one in special:
        if all(left.count(entry) for entry in one["plain"]):
            for entry in one["plain"]:
                left.remove(entry)
            kept.append((int(one["at"]), one["entry"]))
        else:
            other(f"connection {one['entry']}")
    for at, entry in sorted(kept, key=lambda pair: pair[0]):
        left.insert(at, entry)
    return left


def step_hints(document: Document) -> list[tuple[str, str]]:
    """Step sizes [s] that annotations of known tools give, and whose they are."""
    found = []
    for kind, node in document.annotations:
        if kind == OSP_TYPE:
            found += [
                (one.get("baseStepSize"), "the Open Simulation Platform")
                for one in node.iter(f"{{{OSP}}}FixedStepAlgorithm")
            ]
        elif kind == "org.openmodelica":
            found += [
                (one.get("stepSize"), "OMSimulator")
                for one in node.iter()
                if isinstance(one.tag, str) and one.tag.endswith("}FixedStepMaster")
            ]
    return [(text, origin) for text, origin in found if text and _positive(text)]


def _positive(text: str) -> bool:
    try:
        return Fraction(text) > 0
    except (ValueError, ZeroDivisionError):
        return False
