"""Units with an offset: differences of two temperatures are converted without it, temperatures with it."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import foreign
import pytest
import yaml

from orchestrator.base.errors import ConfigError
from orchestrator.base.units import UnitError, convert, parse_quantity, parse_unit
from orchestrator.cli.main import main
from orchestrator.results.recorders import read_results
from orchestrator.simulation.run import run

UNITS = """<UnitDefinitions>
  <Unit name="K"><BaseUnit K="1"/>
    <DisplayUnit name="degC" offset="-273.15"/><DisplayUnit name="degF" factor="1.8" offset="-459.67"/></Unit>
  <Unit name="degC"><BaseUnit K="1" offset="273.15"/></Unit>
</UnitDefinitions>
<TypeDefinitions>
  <SimpleType name="Difference"><Real unit="K" relativeQuantity="true"/></SimpleType>
</TypeDefinitions>"""


def echo(path: Path, inputs: dict[str, str] | None = None, parameters: dict[str, str] | None = None) -> Path:
    """An FMU that gives each of its inputs and parameters `name` as output `y_name`, with its attributes."""
    variables = []
    for causality, names in (("input", inputs), ("parameter", parameters)):
        for name, attributes in (names or {}).items():
            number = len(variables) // 2 + 1
            variability = ' variability="fixed"' if causality == "parameter" else ""
            variables.append(
                f'<ScalarVariable name="{name}" valueReference="{number}" causality="{causality}"'
                f'{variability}><Real start="0" {attributes}/></ScalarVariable>'
            )
            variables.append(
                f'<ScalarVariable name="y_{name}" valueReference="{100 + number}" causality="output">'
                f"<Real {attributes}/></ScalarVariable>"
            )
    outputs = range(2, len(variables) + 1, 2)
    listed = "".join(f'<Unknown index="{one}" dependencies="{one - 1}"/>' for one in outputs)
    xml = (
        f'<fmiModelDescription fmiVersion="2.0" modelName="Echo" guid="{{e}}">'
        f'<CoSimulation modelIdentifier="Echo" canHandleVariableCommunicationStepSize="true"/>{UNITS}'
        f"<ModelVariables>{''.join(variables)}</ModelVariables>"
        f"<ModelStructure><Outputs>{listed}</Outputs><InitialUnknowns>{listed}</InitialUnknowns>"
        "</ModelStructure></fmiModelDescription>"
    )
    return foreign.pack(path, "echo.c", 2, "Echo", xml)


def last(folder: Path, instances: dict, connections: list, *more: str) -> dict[str, float]:
    """The last values of all signals of a run with these instances and connections."""
    config = {
        "run": {"master": "jacobi", "step_size": "0.1 s", "stop_time": "0.2 s"},
        "instances": instances,
        "connections": connections,
    }
    path = folder / "system.yaml"
    path.write_text(yaml.safe_dump(config), encoding="utf-8")
    assert main(["run", str(path), "--out", str(folder / "out"), *more]) == 0
    results = read_results(folder / "out")
    return {name: float(results[name][-1]) for name in results.signals}


RELATIVE = 'unit="K" relativeQuantity="true"'
TYPED = 'declaredType="Difference"'


def test_start_values_of_differences(tmp_path):
    names = {"c": RELATIVE, "f": RELATIVE, "typed": TYPED, "absolute": 'unit="K"', "delta": RELATIVE}
    echo(tmp_path / "Warm.fmu", parameters=names)
    start = {"c": "5 degC", "f": "9 degF", "typed": "5 degC", "absolute": "5 degC", "delta": "5 delta_degC"}
    found = last(tmp_path, {"w": {"fmu": "Warm.fmu", "start": start}}, [])
    assert found == pytest.approx(
        {"w.y_c": 5.0, "w.y_f": 5.0, "w.y_typed": 5.0, "w.y_absolute": 278.15, "w.y_delta": 5.0}, abs=1e-12
    )


@pytest.mark.parametrize(
    ("out", "into", "expected"),
    [
        (RELATIVE, 'unit="degC" relativeQuantity="true"', 10.0),
        ('unit="K"', 'unit="degC"', -263.15),
        ('unit="degC" relativeQuantity="true"', 'unit="K"', None),
        (RELATIVE, 'unit="degC"', None),
        ('unit="degC" relativeQuantity="true"', 'unit="degC"', 10.0),
    ],
)
def test_connections_of_differences(tmp_path, capsys, out, into, expected):
    echo(tmp_path / "Out.fmu", parameters={"d": out})
    echo(tmp_path / "In.fmu", inputs={"u": into})
    unit = "K" if '"K"' in out else "delta_degC"
    instances = {"o": {"fmu": "Out.fmu", "start": {"d": f"10 {unit}"}}, "i": {"fmu": "In.fmu"}}
    if expected is not None:
        assert last(tmp_path, instances, ["o.y_d -> i.u"])["i.y_u"] == pytest.approx(expected)
    elif 'unit="K"' in into:
        # A unit of differences has no origin, neither has K: a factor is all that there is.
        assert last(tmp_path, instances, ["o.y_d -> i.u"])["i.y_u"] == 10.0
    else:
        with pytest.raises(AssertionError):
            last(tmp_path, instances, ["o.y_d -> i.u"])
        assert "K is a unit of differences here, degC has an origin" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("effect", "expected"),
    [
        ({"offset": "5 K"}, 25.0),
        ({"offset": "9 degF"}, 25.0),
        ({"quantise": "15 K"}, 15.0),
        ({"dead-band": "5 delta_degC"}, 15.0),
        ({"saturate": {"high": "283.15 K"}}, 10.0),  # a limit is a temperature
        ({"backlash": "4 K"}, 20.0),
    ],
)
def test_options_of_effects_are_differences_where_they_are_sizes(tmp_path, effect, expected):
    echo(tmp_path / "Out.fmu", parameters={"d": 'unit="degC"'})
    echo(tmp_path / "In.fmu", inputs={"u": 'unit="degC"'})
    instances = {"o": {"fmu": "Out.fmu", "start": {"d": "20 degC"}}, "i": {"fmu": "In.fmu"}}
    found = last(tmp_path, instances, [{"from": "o.y_d", "to": "i.u", "through": [effect]}])
    assert found["i.y_u"] == pytest.approx(expected)


def test_sums_in_units_with_an_offset(tmp_path):
    echo(tmp_path / "Out.fmu", parameters={"c": 'unit="degC"', "k": 'unit="K"'})
    echo(tmp_path / "In.fmu", inputs={"kelvin": 'unit="K"', "celsius": 'unit="degC"'})
    instances = {"o": {"fmu": "Out.fmu", "start": {"c": "20 degC", "k": "290.15 K"}}, "i": {"fmu": "In.fmu"}}
    difference = [{"port": "o.y_c"}, {"port": "o.y_k", "gain": -1}]
    mean = [{"port": "o.y_c", "gain": 0.5}, {"port": "o.y_k", "gain": 0.5}]
    found = last(
        tmp_path, instances, [{"from": difference, "to": "i.kelvin"}, {"from": mean, "to": "i.celsius"}]
    )
    assert found["i.y_kelvin"] == pytest.approx(3.0)  # 20 degC less 17 degC
    assert found["i.y_celsius"] == pytest.approx(18.5)


def test_units_of_differences():
    celsius, delta = parse_unit("degC"), parse_unit("delta_degC")
    assert parse_quantity("5 degC").exactly(parse_unit("K")) == Fraction("278.15")
    assert parse_quantity("9 degF").exactly(parse_unit("K").of_differences()) == 5
    assert parse_quantity("9 delta_degF").exactly(delta) == 5
    assert convert(celsius.of_differences(), parse_unit("delta_degF")) == (1.8, 0.0)
    assert parse_quantity("3 delta_degC/min").exactly(parse_unit("K/s")) == Fraction(1, 20)
    with pytest.raises(UnitError, match="delta_degC is a unit of differences here, degC has an origin"):
        parse_quantity("5 delta_degC").exactly(celsius)


@pytest.mark.parametrize(
    ("sources", "target", "right"),
    [
        (["k.y_T", {"port": "c.y_T", "gain": -1}], "into.d", 6.85),
        (["k.y_T", "c.y_d"], "into.kelvin", 304.0),
        (["c.y_d", "k.y_T"], "into.celsius", 30.85),
        ([{"port": "k.y_T", "gain": 0.5}, {"port": "c.y_T", "gain": 0.5}], "into.kelvin", 296.575),
    ],
)
def test_sums_of_values_and_differences_in_any_order(sources, target, right, tmp_path):
    found = summed(sources, target, tmp_path)
    assert found == pytest.approx(right, rel=1e-12)


def test_a_sum_that_depends_on_the_origins_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="gains whose sum is 1"):
        summed(["k.y_T", "c.y_T"], "into.kelvin", tmp_path)


def summed(sources, target, folder):
    """The value that an input gets, of T = 300 K in k, and T = 20 degC and a difference d = 4 degC in c."""
    relative = 'unit="degC" relativeQuantity="true"'
    echo(folder / "K.fmu", parameters={"T": 'unit="K"'})
    echo(folder / "C.fmu", parameters={"T": 'unit="degC"', "d": relative})
    units = {"kelvin": 'unit="K"', "celsius": 'unit="degC"', "d": relative}
    name = target.partition(".")[2]
    echo(folder / "Into.fmu", inputs={name: units[name]})
    config = {
        "run": {"master": "jacobi", "step_size": "0.1 s", "stop_time": "0.2 s"},
        "instances": {
            "k": {"fmu": str(folder / "K.fmu"), "start": {"T": "300 K"}},
            "c": {"fmu": str(folder / "C.fmu"), "start": {"T": "20 degC", "d": "4 degC"}},
            "into": {"fmu": str(folder / "Into.fmu")},
        },
        "connections": [{"from": sources, "to": target}],
    }
    return run(config, halving=False).results[f"into.y_{name}"][-1]
