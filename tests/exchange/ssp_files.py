"""System structure packages for the tests."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path

from orchestrator.exchange.ssp.elements import SPACES
from orchestrator.fmi import bundled

_SPACES = " ".join(f'xmlns:{short}="{space}"' for short, space in SPACES.items())
UNITS = """<ssd:Units>
  <ssc:Unit name="m"><ssc:BaseUnit m="1"/></ssc:Unit>
  <ssc:Unit name="mm"><ssc:BaseUnit m="1" factor="0.001"/></ssc:Unit>
  <ssc:Unit name="m/s"><ssc:BaseUnit m="1" s="-1"/></ssc:Unit>
  <ssc:Unit name="N"><ssc:BaseUnit kg="1" m="1" s="-2"/></ssc:Unit>
</ssd:Units>"""
ROBOT = """<ssd:Connectors>
  <ssd:Connector name="command" kind="input"><ssc:Real/></ssd:Connector>
  <ssd:Connector name="position" kind="output"><ssc:Real unit="m"/></ssd:Connector>
  <ssd:Connector name="velocity" kind="output"><ssc:Real unit="m/s"/></ssd:Connector>
</ssd:Connectors>"""
CONTACT = """<ssd:Connectors>
  <ssd:Connector name="position" kind="input"><ssc:Real/></ssd:Connector>
  <ssd:Connector name="velocity" kind="input"><ssc:Real/></ssd:Connector>
  <ssd:Connector name="force" kind="output"><ssc:Real unit="N"/></ssd:Connector>
</ssd:Connectors>"""


def fmu(name: str) -> bytes:
    """Content of a bundled FMU."""
    path = bundled.find_fmu(name)
    assert path is not None
    return path.read_bytes()


def component(name: str, source: str, inner: str = "", **attributes: str) -> str:
    """A component; `source` is a file in resources/, unless it has a slash or a #."""
    where = source if "/" in source or "#" in source or not source else f"resources/{source}"
    more = "".join(f' {key}="{text}"' for key, text in attributes.items())
    return f'<ssd:Component name="{name}" source="{where}"{more}>{inner}</ssd:Component>'


def wire(start: str, end: str, inner: str = "", **attributes: str) -> str:
    """A connection between "element.connector", or ".connector" of the system itself."""
    text = "<ssd:Connection"
    for side, one in (("start", start), ("end", end)):
        element, _, connector = one.partition(".")
        text += f' {side}Element="{element}"' if element else ""
        text += f' {side}Connector="{connector}"'
    text += "".join(f' {key}="{value}"' for key, value in attributes.items())
    return f"{text}>{inner}</ssd:Connection>"


def system(
    name: str, elements: str, connections: str = "", before: str = "", after: str = "", **more: str
) -> str:
    """A system: `before` its elements stand connectors and bindings, `after` its connections dictionaries."""
    links = f"<ssd:Connections>{connections}</ssd:Connections>" if connections else ""
    attributes = "".join(f' {key}="{text}"' for key, text in more.items())
    inner = f"{before}<ssd:Elements>{elements}</ssd:Elements>{links}{after}"
    return f'<ssd:System name="{name}"{attributes}>{inner}</ssd:System>'


def ssd(root: str, units: str = UNITS, version: str = "1.0", experiment: str = "") -> str:
    """A system structure description of a root system."""
    head = f'<ssd:SystemStructureDescription {_SPACES} version="{version}" name="test">'
    default = experiment or '<ssd:DefaultExperiment startTime="0" stopTime="0.1"/>'
    return f'<?xml version="1.0"?>\n{head}{root}{units}{default}</ssd:SystemStructureDescription>'


def ssv(parameters: Mapping[str, str], inline: bool = False) -> str:
    """A parameter set, of elements such as `<ssv:Real value="1"/>` by name."""
    inner = "".join(f'<ssv:Parameter name="{name}">{one}</ssv:Parameter>' for name, one in parameters.items())
    units = UNITS.replace("ssd:", "ssv:")
    spaces = "" if inline else f" {_SPACES}"
    head = f'<ssv:ParameterSet{spaces} version="1.0" name="p">'
    return f"{head}<ssv:Parameters>{inner}</ssv:Parameters>{units}</ssv:ParameterSet>"


def binding(parameters: Mapping[str, str], mapping: str = "", **attributes: str) -> str:
    """A parameter binding with a set inside."""
    more = "".join(f' {key}="{text}"' for key, text in attributes.items())
    inner = f"<ssd:ParameterValues>{ssv(parameters, inline=True)}</ssd:ParameterValues>"
    return f"<ssd:ParameterBinding{more}>{inner}{mapping}</ssd:ParameterBinding>"


def bindings(*texts: str) -> str:
    """Parameter bindings of an element."""
    return f"<ssd:ParameterBindings>{''.join(texts)}</ssd:ParameterBindings>"


def mapping(entries: str, inline: bool = True) -> str:
    """A parameter mapping, inline or as a file."""
    if inline:
        inner = f'<ssm:ParameterMapping version="1.0">{entries}</ssm:ParameterMapping>'
        return f"<ssd:ParameterMapping>{inner}</ssd:ParameterMapping>"
    return f'<ssm:ParameterMapping {_SPACES} version="1.0">{entries}</ssm:ParameterMapping>'


def real(value: str, unit: str = "") -> str:
    """A real value of a parameter."""
    return f'<ssv:Real value="{value}"' + (f' unit="{unit}"/>' if unit else "/>")


def package(path: Path, root: str, files: Mapping[str, str | bytes] = {}) -> Path:
    """A package of a description (or of a root system) and files in resources/."""
    text = root if root.startswith("<?xml") else ssd(root)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("SystemStructure.ssd", text)
        for name, content in files.items():
            archive.writestr(f"resources/{name}", content)
    return path


# What most packages of the tests hold.
FMUS = {"robot.fmu": fmu("RobotResponse"), "contact.fmu": fmu("DockingContact")}
