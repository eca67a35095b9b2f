"""FMUs such as other tools make them, compiled for the tests."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from functools import lru_cache
from pathlib import Path
from tempfile import mkdtemp

import fmpy

SOURCES = Path(__file__).parent / "fmu_sources"


@lru_cache
def _library(source: str, version: int) -> bytes:
    folder = Path(mkdtemp(prefix="foreign-"))
    output = folder / f"library{fmpy.sharedLibraryExtension}"
    command = [sys.executable, "-m", "ziglang", "cc", "-shared", "-fPIC", "-O1", "-fno-sanitize=all", "-w"]
    command += [f"-DFMI={version}", "-o", str(output), str(SOURCES / source)]
    subprocess.run(command, check=True, capture_output=True)
    data = output.read_bytes()
    for file in folder.iterdir():
        file.unlink()
    folder.rmdir()
    return data


def pack(path: Path, source: str, version: int, identifier: str, xml: str) -> Path:
    """An FMU of a C source and a model description."""
    platform = fmpy.platform_tuple if version == 3 else fmpy.platform
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", xml)
        archive.writestr(
            f"binaries/{platform}/{identifier}{fmpy.sharedLibraryExtension}", _library(source, version)
        )
    return path


_BOUNCE1 = """<?xml version="1.0" encoding="ISO-8859-1"?>
<fmiModelDescription fmiVersion="1.0" modelName="Bounce" modelIdentifier="Bounce" guid="{{b}}"
    numberOfContinuousStates="2" numberOfEventIndicators="1">
  <ModelVariables>
    <ScalarVariable name="h" valueReference="1" causality="output"><Real start="1" fixed="true"/></ScalarVariable>
    <ScalarVariable name="v" valueReference="2" causality="output"><Real start="0" fixed="true"/>
      <DirectDependency/></ScalarVariable>
    <ScalarVariable name="u" valueReference="3" causality="input"><Real start="-9.81"/></ScalarVariable>
    <ScalarVariable name="count" valueReference="4" causality="output" variability="discrete"><Integer/>
      <DirectDependency/></ScalarVariable>
    <ScalarVariable name="restitution" valueReference="5" variability="parameter"><Real start="0.5"/></ScalarVariable>
    <ScalarVariable name="fail" valueReference="6" variability="parameter"><Integer start="0"/></ScalarVariable>
    <ScalarVariable name="fall" valueReference="2" causality="output" alias="negatedAlias"><Real/>
      <DirectDependency/></ScalarVariable>
    <ScalarVariable name="rises" valueReference="8" causality="output" variability="discrete"><Boolean/>
      <DirectDependency/></ScalarVariable>
  </ModelVariables>
  {implementation}
</fmiModelDescription>"""

_SLAVE1 = """<Implementation><CoSimulation_StandAlone>
    <Capabilities canHandleVariableCommunicationStepSize="true" canBeInstantiatedOnlyOncePerProcess="true"/>
  </CoSimulation_StandAlone></Implementation>"""

_BOUNCE2 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="Bounce" guid="{b}" numberOfEventIndicators="1">
  <ModelExchange modelIdentifier="Bounce"/>
  <ModelVariables>
    <ScalarVariable name="h" valueReference="1" causality="output" initial="exact"><Real start="1"/></ScalarVariable>
    <ScalarVariable name="v" valueReference="2" causality="output" initial="exact"><Real start="0"/></ScalarVariable>
    <ScalarVariable name="u" valueReference="3" causality="input" variability="discrete"><Real start="-9.81"/></ScalarVariable>
    <ScalarVariable name="count" valueReference="4" causality="output" variability="discrete"><Integer/></ScalarVariable>
    <ScalarVariable name="restitution" valueReference="5" causality="parameter" variability="fixed"><Real start="0.5"/></ScalarVariable>
    <ScalarVariable name="fail" valueReference="6" causality="parameter" variability="fixed"><Integer start="0"/></ScalarVariable>
    <ScalarVariable name="der(h)" valueReference="2"><Real derivative="1"/></ScalarVariable>
    <ScalarVariable name="der(v)" valueReference="3"><Real derivative="2"/></ScalarVariable>
  </ModelVariables>
  <ModelStructure>
    <Outputs><Unknown index="1" dependencies=""/><Unknown index="2" dependencies=""/><Unknown index="4" dependencies=""/></Outputs>
    <Derivatives><Unknown index="7" dependencies="2"/><Unknown index="8" dependencies="3"/></Derivatives>
    <InitialUnknowns><Unknown index="4"/><Unknown index="7"/><Unknown index="8"/></InitialUnknowns>
  </ModelStructure>
</fmiModelDescription>"""

_BOUNCE3 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="Bounce" instantiationToken="{b}">
  <ModelExchange modelIdentifier="Bounce"/>
  <ModelVariables>
    <Float64 name="time" valueReference="0" causality="independent"/>
    <Float64 name="h" valueReference="1" causality="output" initial="exact" start="1"/>
    <Float64 name="v" valueReference="2" causality="output" initial="exact" start="0"/>
    <Float64 name="u" valueReference="3" causality="input" variability="discrete" start="-9.81"/>
    <Int32 name="count" valueReference="4" causality="output"/>
    <Float64 name="restitution" valueReference="5" causality="parameter" variability="fixed" start="0.5"/>
    <Int32 name="fail" valueReference="6" causality="parameter" variability="fixed" start="0"/>
    <Float64 name="der(h)" valueReference="7" derivative="1"/>
    <Float64 name="der(v)" valueReference="8" derivative="2"/>
    <Float64 name="z" valueReference="9"/>
  </ModelVariables>
  <ModelStructure>
    <Output valueReference="1" dependencies=""/><Output valueReference="2" dependencies=""/>
    <Output valueReference="4" dependencies=""/>
    <ContinuousStateDerivative valueReference="7"/><ContinuousStateDerivative valueReference="8"/>
    <InitialUnknown valueReference="4"/><InitialUnknown valueReference="7"/><InitialUnknown valueReference="8"/>
    <EventIndicator valueReference="9"/>
  </ModelStructure>
</fmiModelDescription>"""


def bounce(path: Path, version: int, *, slave: bool = False) -> Path:
    """The ball of bounce.c, for model exchange; with `slave` for FMI 1.0 co-simulation."""
    implementation = _SLAVE1 if slave else ""
    xml = {1: _BOUNCE1.format(implementation=implementation), 2: _BOUNCE2, 3: _BOUNCE3}[version]
    return pack(path, "bounce.c", version, "Bounce", xml)


_WILD = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="Wild" guid="{w}" generationTool="Wild tool 1">
  <CoSimulation modelIdentifier="Wild" VARIABLE/>
  <DefaultExperiment stepSize="0.1"/>
  <ModelVariables>
    <ScalarVariable name="u" valueReference="1" causality="input"><Real start="0"/></ScalarVariable>
    <ScalarVariable name="y" valueReference="2" causality="output"><Real/></ScalarVariable>
    <ScalarVariable name="at" valueReference="3" causality="parameter" variability="fixed"><Real start="0"/></ScalarVariable>
    <ScalarVariable name="way" valueReference="4" causality="parameter" variability="fixed"><Integer start="0"/></ScalarVariable>
  </ModelVariables>
  <ModelStructure>
    <Outputs><Unknown index="2" dependencies=""/></Outputs>
    <InitialUnknowns><Unknown index="2" dependencies=""/></InitialUnknowns>
  </ModelStructure>
</fmiModelDescription>"""


def wild(path: Path, capabilities: str = 'canHandleVariableCommunicationStepSize="true"') -> Path:
    """The FMU of wild.c."""
    return pack(path, "wild.c", 2, "Wild", _WILD.replace("VARIABLE", capabilities))


_ARRAYS = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="Arrays" instantiationToken="{a}">
  <CoSimulation modelIdentifier="Arrays" canHandleVariableCommunicationStepSize="true" hasEventMode="true"/>
  <ModelVariables>
    <Float64 name="time" valueReference="0" causality="independent"/>
    <Float64 name="gain" valueReference="1" causality="parameter" variability="fixed" start="1 2 3 4 5 6">
      <Dimension start="2"/><Dimension start="3"/></Float64>
    <Float64 name="u" valueReference="2" causality="input" start="1"><Dimension start="3"/></Float64>
    <Float64 name="y" valueReference="3" causality="output"><Dimension start="2"/></Float64>
    <Int32 name="count" valueReference="4" causality="output"/>
    MORE
  </ModelVariables>
  <ModelStructure>
    <Output valueReference="3" dependencies="2"/><Output valueReference="4" dependencies=""/>
    <InitialUnknown valueReference="3" dependencies="2"/><InitialUnknown valueReference="4" dependencies=""/>
  </ModelStructure>
</fmiModelDescription>"""


def arrays(path: Path, more: str = "") -> Path:
    """The FMU of arrays.c; `more` are further variables."""
    return pack(path, "arrays.c", 3, "Arrays", _ARRAYS.replace("MORE", more))
