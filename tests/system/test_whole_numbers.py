"""Whole numbers of 64 bits, of which signals hold those up to 2^53, and what results cannot hold."""

from __future__ import annotations

import numpy as np
import pytest
from archives import repack

from orchestrator.base.errors import ConfigError
from orchestrator.cli.main import main
from orchestrator.simulation.run import run

BEYOND = 2**53 + 1


@pytest.fixture
def whole(c_fmu, tmp_path):
    """An FMU whose level_out follows level_in, both Int64, by the causality of level_in."""

    def made(causality="input"):
        def change(name, data):
            if name == "modelDescription.xml":
                fixed = ' variability="tunable"' if causality == "parameter" else ' variability="discrete"'
                data = data.replace(
                    b'<Enumeration name="level_in" valueReference="9" causality="input" declaredType="Level"',
                    f'<Int64 name="level_in" valueReference="9" causality="{causality}"{fixed}'.encode(),
                )
                data = data.replace(b'<Enumeration name="level_out"', b'<Int64 name="level_out"')
                data = data.replace(b'causality="output" declaredType="Level"', b'causality="output"')
            return name, data

        repack(c_fmu, tmp_path / "Whole.fmu", change)
        return tmp_path / "Whole.fmu"

    return made


def config(fmu, **start):
    return {
        "run": {
            "master": "gauss-seidel",
            "step_size": "0.1 s",
            "stop_time": "1 s",
            "record": ["one.level_out"],
        },
        "instances": {"one": {"fmu": str(fmu), "start": {"limit": "1e9 mm", **start}}},
        "connections": [],
    }


@pytest.mark.parametrize("value", [BEYOND, -BEYOND, 2**63 - 2])
def test_a_start_value_that_is_no_signal_is_refused(whole, value):
    with pytest.raises(ConfigError) as caught:
        run(config(whole(), level_in=value))
    assert (
        str(caught.value)
        .splitlines()[0]
        .endswith(
            f"instances.one.start.level_in: one.level_in = {value}: a signal would hold {int(float(value))}"
        )
    )


@pytest.mark.parametrize("value", [2**53, -(2**63), 2**63 - 1, 2**60])
def test_those_that_are_signals_arrive(whole, value):
    made = run(config(whole(), level_in=value), halving=False)
    # The float next to the largest number is one beyond it; columns of results are whole numbers.
    assert made.results["one.level_out"].dtype == np.int64 and made.results["one.level_out"][-1] == value
    assert not [line for lines in made.summary["run"]["log"].values() for line in lines]


def test_a_parameter_is_exact_and_what_becomes_of_it_is_reported(whole, capsys, tmp_path):
    made = run(
        config(whole("parameter"), level_in=BEYOND), halving=False, out=tmp_path / "out", figures=False
    )
    assert made.results.parameters["one.level_in"] == BEYOND
    assert made.results["one.level_out"][-1] == BEYOND - 1
    reported = [line for lines in made.summary["run"]["log"].values() for line in lines]
    assert any(
        f"level_out is {BEYOND} at 0.1 s; as a signal, a 64-bit float, it is {BEYOND - 1}" in one
        for one in reported
    )


def test_a_number_beyond_within_the_run_is_warned_of_once(whole, tmp_path):
    path = tmp_path / "signals.csv"
    path.write_text("time,level_in\n0,1\n0.4,-53\n0.7,1\n")
    data = config(whole()) | {"connections": ["drive.level_in -> one.level_in"]}
    data["instances"]["drive"] = {"fmu": str(path)}
    made = run(data, halving=False)
    column = made.results["one.level_out"]
    assert column.max() == BEYOND - 1 and column[0] == column[-1] == 1
    (line,) = made.summary["run"]["log"]["one"]
    assert line.endswith(f"level_out is {BEYOND} at 0.5 s; as a signal, a 64-bit float, it is {BEYOND - 1}")


def test_the_native_loop_warns_of_numbers_that_may_be_rounded(whole):
    pytest.importorskip("numba")
    data = config(whole(), level_in=-53)
    data["run"]["loop"] = "native"
    (line,) = run(data, halving=False).summary["run"]["log"]["one"]
    assert f"level_out is near {BEYOND - 1} at 0.1 s; as a signal, a 64-bit float, it may be rounded" in line


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (str(BEYOND), f"is no signal, which is a 64-bit float, exact up to 2^53, and would be {BEYOND - 1}"),
        (str(2**63), f"is beyond Int64, which holds {-(2**63)} to {2**63 - 1}"),
        ("1" * 400, "is no whole number"),
        ("1.5", "is no whole number"),
    ],
)
def test_a_file_of_signals_is_refused_before_the_run(whole, text, said, tmp_path, capsys):
    path = tmp_path / "signals.csv"
    path.write_text(f"time,level_in\n0,1\n1,{text}\n")
    assert main(["run", str(whole()), "--input", str(path)]) == 2
    assert f"signals.csv:3: level_in: {text!r} {said}" in capsys.readouterr().err


def test_a_file_of_signals_brings_the_largest_numbers(whole, tmp_path):
    path = tmp_path / "signals.csv"
    path.write_text(f"time,level_in\n0,{-(2**63)}\n0.5,{2**63 - 1}\n")
    data = config(whole()) | {"connections": ["drive.level_in -> one.level_in"]}
    data["instances"]["drive"] = {"fmu": str(path)}
    levels = run(data, halving=False).results["one.level_out"].tolist()
    assert levels[1] == -(2**63) and levels[-1] == 2**63 - 1


@pytest.mark.parametrize(
    ("pattern", "why"),
    [
        ("word_out", "of type String: results hold numbers, Booleans and items of enumerations only"),
        ("real_in", "an input: record its source"),
    ],
)
def test_what_cannot_be_recorded_is_refused_with_the_reason(c_fmu, pattern, why, capsys):
    for asked in (pattern, f"{pattern[:-1]}*"):
        assert main(["run", str(c_fmu), "--record", asked]) == 2
        assert f"--record: Types3.{pattern} cannot be recorded\n  it is {why}" in capsys.readouterr().err
    with pytest.raises(ConfigError, match=f"one.{pattern} cannot be recorded\n  it is {why}"):
        run(config(c_fmu) | {"run": {**config(c_fmu)["run"], "record": [f"one.{pattern}"]}})


def test_a_pattern_takes_what_can_be_recorded(c_fmu, tmp_path):
    arguments = ["run", str(c_fmu), "--record", "*_*", "--step-size", "0.1 s", "--set", "start.word_in=x"]
    assert main([*arguments, "--out", str(tmp_path / "out"), "--no-figures"]) == 0
