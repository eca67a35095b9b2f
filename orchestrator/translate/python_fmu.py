"""Python model -> FMI 2.0 co-simulation FMU: pythonfmu's builder, then completed and made reproducible.

A model is one Python file with one subclass of pythonfmu's Fmi2Slave, declared `class Name(Fmi2Slave):` (the
FMU's loader looks for exactly that); what it imports from shared/ is put before it (see shared_source).
Beyond what pythonfmu reads, an instance of it may carry

- `type_attributes`: variable -> attributes of its FMI type element (unit, displayUnit, quantity, min, max);
- `enumerations`: variable -> (type name, value by item name), for a variable registered as an Integer;
- `dependencies`: output -> inputs that it depends on at one and the same communication point;
- `initial_dependencies`: output -> variables that its initial value depends on;
- `requirements`: packages that the model needs where it runs, as a tuple of texts such as "numpy>=2.4",
  which are checked there (pythonfmu itself travels in the FMU).
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import html
import importlib.metadata
import inspect
import re
import sys
import tempfile
import uuid
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from orchestrator.base.errors import BuildError, listed
from orchestrator.base.temporary_folders import scratch_root
from orchestrator.base.units import BASE_NAMES, Unit, UnitError, parse_unit
from orchestrator.translate.inserted import appended, requirements_check
from orchestrator.translate.package import write_fmu
from orchestrator.translate.presentation import Section, dress, sources_of, text_section
from orchestrator.translate.shared_source import assembled, pieces

try:
    from lxml import etree
    from pythonfmu import FmuBuilder
except ImportError as error:
    raise BuildError(
        f"Python FMU: the package {error.name} is not installed; run `pip install 'orchestrator[build]'`"
    ) from error

_OPTIONS = {
    # Python itself is the tool that has to be there.
    "needsExecutionTool": True,
    "canHandleVariableCommunicationStepSize": True,
    "canGetAndSetFMUstate": True,
    "canSerializeFMUstate": True,
}
_CLASS = re.compile(r"^class (\w+)\(\s*Fmi2Slave\s*\)\s*:", re.MULTILINE)
_REQUIREMENT = re.compile(r"[\w.-]+(>=[\d.]+)?")
_TYPES = ("Real", "Integer", "Boolean", "String", "Enumeration")
_INDENT = "  "


def build_python_fmu(script: Path, output: Path) -> Path:
    """Build the FMU of a Python model; its bytes depend on its sources and on pythonfmu's version alone.

    Args:
        script: Python file with one class `class Name(Fmi2Slave):`; Name becomes the model's name.
        output: the FMU to write; an existing file is replaced, missing folders are made.
    Returns: `output`.
    Raises: BuildError if the script cannot be loaded, has not exactly one such class, or leaves something
        about a variable unsaid (a unit, a dependency).
    """
    script, output = Path(script), Path(output)
    members, root, model = described_model(script)
    requirements = tuple(getattr(model, "requirements", ()))
    members["resources/requirements.txt"] = "".join(f"{name}\n" for name in requirements).encode()
    sections = [*docstrings(model, script), _where_it_runs(requirements)]
    made_of = sources_of(source_files(script), ("pythonfmu",))
    members |= dress(etree.tostring(root), sections, made_of)
    members["documentation/licenses/pythonfmu.txt"] = _licence()
    root.set("guid", _content_id(members, root))
    etree.indent(root, _INDENT)
    members["modelDescription.xml"] = etree.tostring(root, xml_declaration=True, encoding="UTF-8") + b"\n"
    output.parent.mkdir(parents=True, exist_ok=True)
    write_fmu(output, members)
    return output


def described_model(script: Path) -> tuple[dict[str, bytes], Any, Any]:
    """Load a Python model and complete what pythonfmu says about it.

    Args:
        script: as for `build_python_fmu`.
    Returns: members of pythonfmu's FMU but its model description; the root of that, completed and without
        an identifier of its content; an instance of the model.
    Raises: BuildError as `build_python_fmu`.
    """
    source = assembled(script).encode("utf-8")
    names = _CLASS.findall(source.decode("utf-8"))
    if len(names) != 1:
        raise BuildError(
            f"{script.name}: classes derived from Fmi2Slave: {listed(names)}; there must be exactly one, "
            "written `class Name(Fmi2Slave):` on one line"
        )
    members, model = _run_builder(script, _checking(source, names[0]), names[0])
    root = etree.fromstring(members.pop("modelDescription.xml"), etree.XMLParser(remove_blank_text=True))
    _complete(root, model, script.name)
    return members, root, model


def _checking(source: bytes, name: str) -> bytes:
    """The source with a check of what it requires before its own imports; as it is if it requires nothing."""
    tree = ast.parse(source)
    classes = [node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == name]
    values = [
        node.value
        for node in (classes[0].body if classes else ())
        if isinstance(node, ast.Assign) and [ast.unparse(one) for one in node.targets] == ["requirements"]
    ]
    requirements = ast.literal_eval(values[0]) if values else ()
    if not requirements:
        return source
    wrong = [item for item in requirements if not _REQUIREMENT.fullmatch(item)]
    if wrong:
        raise BuildError(f'{name}: requirements: cannot read {listed(wrong)}; written as "numpy>=2.4"')
    line = 0
    for node in tree.body:
        docstring = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if not docstring and not (isinstance(node, ast.ImportFrom) and node.module == "__future__"):
            break
        line = node.end_lineno or node.lineno
    lines = source.split(b"\n")
    check = requirements_check(name, requirements)
    return b"\n".join([*lines[:line], check.encode(), *lines[line:]])


def _run_builder(script: Path, source: bytes, class_name: str) -> tuple[dict[str, bytes], Any]:
    """Let pythonfmu build; return the members of its FMU and an instance of the model."""
    source += appended(class_name).encode()
    # The module's name holds the content's hash: Python keeps one module of a name per process, so two
    # FMUs, or two versions of one, would otherwise run the code of whichever was loaded first.
    module = f"{class_name}_{hashlib.sha256(source).hexdigest()[:12]}"
    path, modules = list(sys.path), set(sys.modules)
    with tempfile.TemporaryDirectory(prefix="fmu-", dir=scratch_root()) as scratch:
        copy = Path(scratch) / f"{module}.py"
        copy.write_bytes(source)
        try:
            built = FmuBuilder.build_FMU(copy, dest=Path(scratch) / f"{class_name}.fmu", **_OPTIONS)
            model = getattr(sys.modules[module], class_name)(instance_name=class_name)
        except Exception as error:
            raise BuildError(f"{script.name}: cannot be loaded: {type(error).__name__}: {error}") from error
        finally:
            sys.path[:] = path
            for name in set(sys.modules) - modules:
                if name == module:
                    del sys.modules[name]
        with zipfile.ZipFile(built) as archive:
            members = {name: archive.read(name) for name in archive.namelist() if not name.endswith("/")}
    return {
        name: content.replace(b"\r\n", b"\n") if name.endswith((".py", ".txt", ".xml")) else content
        for name, content in members.items()
    }, model


def _complete(root: Any, model: Any, place: str) -> None:
    """Add to the model description what pythonfmu leaves out, in the order of the FMI 2.0 schema.

    Raises: BuildError with all that the model does not state.
    """
    problems: list[str] = []
    root.attrib.pop("generationDateAndTime", None)
    variables = {node.get("name"): node for node in root.find("ModelVariables")}
    enumerations = getattr(model, "enumerations", {})
    attributes = getattr(model, "type_attributes", {})
    for table, what in ((enumerations, "enumerations"), (attributes, "type_attributes")):
        for name in table:
            if name not in variables:
                problems.append(f"{what} names {name!r}, which is no variable of the model")
    for name, (type_name, _) in enumerations.items():
        integer = variables[name].find("Integer") if name in variables else None
        if integer is not None:
            integer.tag = "Enumeration"
            integer.set("declaredType", type_name)
        elif name in variables:
            problems.append(f"{name}: an enumeration has to be registered as an Integer")
    units: dict[str, dict[str, Unit]] = {}
    for name, node in variables.items():
        _describe(name, node, attributes.get(name, {}), units, problems)
    for variable in model.vars.values():
        element = variables[variable.name].find("Real")
        if element is not None and element.get("start") is not None:
            # pythonfmu writes 16 digits, one too few for some numbers.
            element.set("start", repr(float(variable.getter())))
    position = list(root).index(root.find("CoSimulation")) + 1
    for element in (_unit_definitions(units), _type_definitions(enumerations)):
        if len(element):
            root.insert(position, element)
            position += 1
    _structure(root, model, variables, problems)
    if problems:
        raise BuildError("\n".join(f"{place}: {one}" for one in problems))


def _describe(
    name: str,
    node: Any,
    attributes: Mapping[str, str],
    units: dict[str, dict[str, Unit]],
    problems: list[str],
) -> None:
    """Set unit, quantity and limits of one variable and collect its units; what is wrong is added."""
    if not node.get("description"):
        problems.append(f"{name}: no description; give one where the variable is registered")
    (element,) = (child for child in node if child.tag in _TYPES)
    for key, value in attributes.items():
        element.set(key, value)
    if element.tag != "Real":
        return
    try:
        unit = parse_unit(attributes["unit"])
        shown = units.setdefault(attributes["unit"], {"": unit})
        if "displayUnit" in attributes:
            display = attributes["displayUnit"]
            other = parse_unit(display)
            if other.same_dimension(unit):
                shown[display] = other
            else:
                both = f"display unit {display} [{other.base()}] for {unit} [{unit.base()}]"
                problems.append(f"{name}: {both}: dimensions differ")
    except KeyError:
        problems.append(
            f'{name}: a Real without a unit; name it in type_attributes, "1" if it has no dimension'
        )
    except UnitError as error:
        problems.append(f"{name}: {error}")


def _unit_definitions(units: Mapping[str, Mapping[str, Unit]]) -> Any:
    root = etree.Element("UnitDefinitions")
    for name in sorted(units):
        node = etree.SubElement(root, "Unit", name=name)
        unit = units[name][""]
        base = etree.SubElement(node, "BaseUnit")
        for symbol, power in zip(BASE_NAMES, unit.exponents, strict=True):
            if power:
                base.set(symbol, str(power))
        if unit.factor != 1:
            base.set("factor", repr(float(unit.factor)))
        if unit.offset:
            base.set("offset", repr(float(unit.offset)))
        for display in sorted(set(units[name]) - {""}):
            other = units[name][display]
            shown = etree.SubElement(node, "DisplayUnit", name=display)
            shown.set("factor", repr(float(unit.factor / other.factor)))
            if unit.offset != other.offset:
                shown.set("offset", repr(float((unit.offset - other.offset) / other.factor)))
    return root


def _type_definitions(enumerations: Mapping[str, tuple[str, Mapping[str, int]]]) -> Any:
    root = etree.Element("TypeDefinitions")
    for type_name, items in sorted(dict(enumerations.values()).items()):
        enumeration = etree.SubElement(etree.SubElement(root, "SimpleType", name=type_name), "Enumeration")
        for item, value in items.items():
            etree.SubElement(enumeration, "Item", name=item, value=str(value))
    return root


def _structure(root: Any, model: Any, variables: Mapping[str, Any], problems: list[str]) -> None:
    """Write ModelStructure: what outputs depend on, at a communication point and initially.

    What is wrong is added.
    """
    index = {name: str(number) for number, name in enumerate(variables, start=1)}
    node = root.find("ModelStructure")
    node.clear()
    outputs = [name for name, variable in variables.items() if variable.get("causality") == "output"]
    # "exact" is settable; everything else an output can be is computed during initialisation.
    initial = [
        name
        for name, variable in variables.items()
        if variable.get("causality") == "calculatedParameter"
        or (name in outputs and variable.get("initial") != "exact")
    ]
    for tag, names, table in (
        ("Outputs", outputs, "dependencies"),
        ("InitialUnknowns", initial, "initial_dependencies"),
    ):
        if not names:
            continue
        known: Mapping[str, Sequence[str]] = getattr(model, table, {})
        element = etree.SubElement(node, tag)
        for name in names:
            missing = [other for other in known.get(name, ()) if other not in index]
            if name not in known or missing:
                wrong = f"names {listed(missing)}, unknown" if missing else "has no dependencies declared"
                problems.append(f"{table}: {name}: {wrong}; give it as a tuple of variables, () for none")
                continue
            depends = " ".join(sorted((index[other] for other in known[name]), key=int))
            etree.SubElement(element, "Unknown", index=index[name], dependencies=depends)


def docstrings(model: Any, script: Path) -> list[Section]:
    """What a model says of itself, its equations among it: the docstrings of its files and its class."""
    texts = {piece.label: ast.get_docstring(ast.parse(piece.text)) for piece in pieces(script)}
    own = texts.pop(script.name, None)
    sections = text_section("Model", own, inspect.cleandoc(type(model).__doc__ or ""))
    for label, text in texts.items():
        sections += text_section(label, text)
    return sections


def source_files(script: Path) -> dict[str, bytes]:
    """The files that a model is made of, by their names in messages."""
    return {piece.label: piece.path.read_bytes().replace(b"\r\n", b"\n") for piece in pieces(script)}


def _where_it_runs(requirements: Sequence[str]) -> Section:
    packages = ", ".join(f"<code>{html.escape(package)}</code>" for package in requirements) or "none"
    return (
        "Where it runs",
        "<p>The model is Python code. It runs in the Python of the importing process (64-bit Python 3.11 or "
        "later; Windows x86-64, or Linux x86-64 with glibc 2.32 and GCC 12's libstdc++ or later): an "
        "importer that is not itself Python must have libpython "
        f"loaded. Packages needed there: {packages}; <code>pip install -r resources/requirements.txt</code>; "
        "what is missing is told when an instance is made. pythonfmu travels in the FMU.</p>",
    )


def _licence() -> bytes:
    """The licence of pythonfmu, whose code and binaries the FMU carries."""
    for file in importlib.metadata.files("pythonfmu") or ():
        if file.name.upper().startswith("LICEN"):
            return file.read_binary().replace(b"\r\n", b"\n")
    raise BuildError("pythonfmu: its licence, which has to travel with its code, is not installed with it")


def _content_id(members: Mapping[str, bytes], root: Any) -> str:
    """An identifier made of everything in the FMU, so that it changes when the FMU does and only then."""
    root.set("guid", "")
    digest = hashlib.sha256(etree.tostring(root))
    for name in sorted(members):
        digest.update(name.encode() + b"\0" + hashlib.sha256(members[name]).digest())
    return str(uuid.UUID(bytes=digest.digest()[:16], version=5))


def main(arguments: Sequence[str] | None = None) -> int:
    """Rebuild the FMUs of Python models in place: fmus/Name/model.py -> fmus/Name/Name.fmu."""
    program = "python -m orchestrator.translate.python_fmu"
    parser = argparse.ArgumentParser(prog=program, description=main.__doc__)
    parser.add_argument("folder", nargs="?", type=Path, default=Path(__file__).parents[2] / "fmus")
    for script in sorted(parser.parse_args(arguments).folder.glob("*/model.py")):
        print(build_python_fmu(script, script.parent / f"{script.parent.name}.fmu"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
