"""The FMU of tests/fmu_sources/unruly.c, built once per process for FMI 2 and FMI 3."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from functools import cache
from pathlib import Path

import fmpy

from orchestrator.base.temporary_folders import scratch_folder

SOURCE = Path(__file__).parent / "fmu_sources" / "unruly.c"
WAYS = (
    "nothing", "warn", "discards", "fails", "terminates", "nan level", "set fails", "get fails", "complains",
    "ends",
)  # fmt: skip

_UNITS = """<UnitDefinitions>
    <Unit name="m"><BaseUnit m="1"/></Unit><Unit name="mm"><BaseUnit m="1" factor="0.001"/></Unit>
    <Unit name="degC"><BaseUnit K="1" offset="273.15"/></Unit><Unit name="K"><BaseUnit K="1"/></Unit>
  </UnitDefinitions>"""
_FMI2 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="Unruly" guid="unruly">
  <CoSimulation modelIdentifier="Unruly" canHandleVariableCommunicationStepSize="true"/>
  {units}
  <ModelVariables>
    <ScalarVariable name="rate" valueReference="0" causality="input"
      ><Real start="0" unit="{rate}"/></ScalarVariable>
    <ScalarVariable name="level" valueReference="1" causality="output"><Real unit="{level}"/></ScalarVariable>
    <ScalarVariable name="through" valueReference="2" causality="output"
      ><Real unit="{rate}"/></ScalarVariable>
    <ScalarVariable name="at" valueReference="3" causality="parameter" variability="tunable"
      ><Real start="1e9"/></ScalarVariable>
    <ScalarVariable name="way" valueReference="4" causality="parameter" variability="tunable"
      ><Integer start="0"/></ScalarVariable>
    <ScalarVariable name="count" valueReference="5" causality="output" variability="discrete"
      ><Integer/></ScalarVariable>
  </ModelVariables>
  <ModelStructure><Outputs>
    <Unknown index="2" dependencies=""/><Unknown index="3" dependencies="1"/>
    <Unknown index="6" dependencies=""/>
  </Outputs></ModelStructure>
</fmiModelDescription>
"""
_FMI3 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="Unruly" instantiationToken="unruly">
  <CoSimulation modelIdentifier="Unruly" canHandleVariableCommunicationStepSize="true"/>
  {units}
  <ModelVariables>
    <Float64 name="rate" valueReference="0" causality="input" start="0" unit="{rate}"/>
    <Float64 name="level" valueReference="1" causality="output" unit="{level}"/>
    <Float64 name="through" valueReference="2" causality="output" unit="{rate}"/>
    <Float64 name="at" valueReference="3" causality="parameter" variability="tunable" start="1e9"/>
    <Int32 name="way" valueReference="4" causality="parameter" variability="tunable" start="0"/>
    <Int32 name="count" valueReference="5" causality="output" variability="discrete"/>
  </ModelVariables>
  <ModelStructure>
    <Output valueReference="1" dependencies=""/><Output valueReference="2" dependencies="0"/>
    <Output valueReference="5" dependencies=""/>
  </ModelStructure>
</fmiModelDescription>
"""


@cache
def unruly_fmu(version: int, rate: str = "m", level: str = "m") -> Path:
    """The FMU for an FMI version, with units of its input and of its output."""
    folder = scratch_folder("unruly-")
    library = folder / f"Unruly{fmpy.sharedLibraryExtension}"
    command = [sys.executable, "-m", "ziglang", "cc", f"-DVERSION={version}", "-shared", "-fPIC", "-O2"]
    command += ["-ffp-contract=off", "-fno-sanitize=all", "-o", str(library), str(SOURCE)]
    subprocess.run(command, check=True, capture_output=True)
    description = (_FMI2 if version == 2 else _FMI3).format(units=_UNITS, rate=rate, level=level)
    place = fmpy.platform if version == 2 else fmpy.platform_tuple
    path = folder / "Unruly.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", description)
        archive.write(library, f"binaries/{place}/{library.name}")
    return path
