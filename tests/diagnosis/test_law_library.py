"""The library of laws: equations, units, and laws that the search finds in small systems."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from orchestrator.base.units import UnitError, parse_unit
from orchestrator.diagnosis.study.reader import load_port_study
from orchestrator.diagnosis.unknown_input.corrected import write_corrected
from orchestrator.diagnosis.unknown_input.inquiry import answer
from orchestrator.diagnosis.unknown_input.laws import Law, library

_FILE = Path(__file__).parents[1] / "benchmarks" / "law_library.py"
_WORDS = {"min": min, "max": max, "abs": abs, "sign": np.sign}
_WORDS |= {one: getattr(np, one) for one in ("tanh", "exp", "sqrt", "sin", "cos", "floor")}


def _bench() -> ModuleType:
    found = importlib.util.spec_from_file_location("law_library", _FILE)
    assert found is not None and found.loader is not None
    module = importlib.util.module_from_spec(found)
    sys.modules["law_library"] = module
    found.loader.exec_module(module)
    return module


BENCH = _bench()
QUICK = [one for one in BENCH.CASES if one.quick]


@pytest.mark.parametrize("law", [one for one in library() if not one.unit], ids=lambda law: law.name)
def test_units_of_a_law_are_those_of_its_equations(law: Law) -> None:
    """In other units of signals, place and time, numbers in their units give the same."""
    angle = any(one.name == "phase" for one in law.numbers) and law.name != "hum"
    sizes = {"u": 1.0 if angle else 2.0, "w": 16.0, "v": 8.0, "s": 0.5, "rad": 1.0}
    if law.reads == "own" or not any("w" in one.unit for one in law.numbers):
        sizes["w"] = sizes["u"]
    numbers = [0.7 + 0.4 * k for k in range(len(law.numbers))]

    def scaled(unit: str) -> float:
        text = re.sub(r"([a-z])(\d)", r"\1**\2", unit.replace(".", "*") if "^" not in unit else unit)
        return float(eval(text.replace("^", "**"), {**sizes, "n": numbers[-1]}))

    moved = [one * scaled(number.unit) for one, number in zip(numbers, law.numbers, strict=True)]
    time = 0.25 * np.arange(40)
    signals = np.column_stack([1.7 * np.sin(0.9 * time), 0.6 + 0.3 * np.cos(0.7 * time)])
    width = 2 if law.second else 1
    before = law.values(time, signals[:, :width], numbers, 0.25)
    other = signals * [sizes["u"], sizes["u" if law.second == "any" else "v"]]
    after = law.values(sizes["s"] * time, other[:, :width], moved, 0.25 * sizes["s"])
    most = float(np.abs(before).max())  # near 0 some laws are rounded off
    assert most > 0.0 and after == pytest.approx(sizes["w"] * before, rel=1e-9, abs=1e-6 * sizes["w"] * most)


def test_radiation_is_that_of_a_black_area() -> None:
    law = next(one for one in library() if one.name == "radiation")
    watts = law.values(np.zeros(1), np.array([300.0]), [1.0, 0.0])
    assert law.numbers[0].unit == "w.m2/W" and watts == pytest.approx(459.3, rel=1e-3)


@pytest.mark.parametrize("law", library(), ids=lambda law: law.name)
def test_equations_of_a_law_are_what_the_search_fits(law: Law) -> None:
    # The Modelica text, evaluated in Python, against the code of the search, at some points and states.
    assert law.modelica.endswith(";") and law.sentence.endswith(".") and len(law.numbers) <= 4
    if law.delay:  # its code is for filters; simulations look the signal up in the past
        word = law.numbers[0].word
        held = f"when sample((share - floor(share))*{word}, {word}) then z1 = u; end when; y = z1 - u;"
        assert law.modelica == {"fixed": f"y = delay(u, {word}) - u;", "held": held}[law.delay]
        return
    numbers = [0.7 + 0.4 * k for k in range(len(law.numbers))]
    names = [one.word for one in law.numbers]
    equations = dict(one.split(" = ") for one in law.modelica.removesuffix(";").split("; "))
    assert set(equations) == {"y", *(f"der(z{k + 1})" for k in range(law.states))}
    out = np.zeros(8)
    for u in (-1.3, -0.2, 0.4, 2.1):
        states = [0.3 * u, -0.5][: law.states]
        scope = {**_WORDS, **dict(zip(names, numbers, strict=True)), "u": u, "v": 0.6, "time": 3.0}
        scope |= {"interval": 0.2, **{f"z{k + 1}": z for k, z in enumerate(states)}}

        def value(name: str, scope: dict[str, object] = scope) -> float:
            text = (
                equations[name]
                .replace("^", "**")
                .replace("der(z1)", "(" + equations.get("der(z1)", "") + ")")
            )
            return float(eval(text, scope))

        law.code(3.0, np.array([u, 0.6, 0.2]), np.array(numbers), np.array([*states, 0.0]), out)
        assert out[0] == pytest.approx(value("y"), rel=1e-9, abs=1e-12)
        for k in range(law.states):
            assert out[1 + k] == pytest.approx(value(f"der(z{k + 1})"), rel=1e-9, abs=1e-12)


def test_names_are_unique_and_units_can_be_read() -> None:
    names = [law.name for law in library()]
    assert len(names) == len(set(names)) >= 60
    for law in library():
        for number in law.numbers:
            text = number.unit.replace("^n", "").replace("^0.5", "").replace("^1.25", "")
            for letter in "wuv":
                text = text.replace(letter, "m")
            try:
                parse_unit(text)
            except UnitError as error:
                pytest.fail(f"{law.name}: {number.unit}: {error}")


def test_a_play_is_crossed_before_the_output_moves() -> None:
    # A triangle of 1 over a play of +-0.3: after each turn the output rests for 0.6 of travel.
    law = next(one for one in library() if one.name == "backlash")
    time = 0.01 * np.arange(400)
    signal = np.abs((time + 1.0) % 2.0 - 1.0) * 2.0 - 1.0
    out, expected = signal + law.values(time, signal, [0.3], 0.01), np.empty(400)
    rest = signal[0]
    for k, value in enumerate(signal):
        rest = expected[k] = min(max(rest, value - 0.3), value + 0.3)
    assert np.abs(out - expected).max() < 0.01


def test_dry_friction_with_memory_ends_at_its_level() -> None:
    # Dahl's friction at constant speed: 1 - exp(-travel / length) of its level.
    law = next(one for one in library() if one.name == "Dahl friction")
    time = 0.01 * np.arange(100)
    found = law.values(time, np.full(100, 0.5), [2.0, 0.1], 0.01)
    assert found == pytest.approx(2.0 * (1.0 - np.exp(-0.5 * time / 0.1)), abs=0.01)


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    pytest.importorskip("rumoca")
    made = {}
    for system in {id(one.system): one.system for one in QUICK}.values():
        made[id(system)] = tmp_path_factory.mktemp("system")
        BENCH.built(system, made[id(system)])
    return made


@pytest.mark.parametrize("case", QUICK, ids=lambda case: case.name)
def test_a_hidden_law_is_found_with_its_numbers(case: Any, folders: Any, tmp_path: Path) -> None:
    study = load_port_study(BENCH.logged(case, folders[id(case.system)]))
    found = answer(study)
    assert BENCH.right(case, found) == "law", found
    assert found.closed > 0.9
    if case.numbers:
        assert np.abs(found.fitted.numbers) == pytest.approx(case.numbers, rel=0.15)
    if found.fitted.laws[0].place.kind != 2:
        assert write_corrected(study, found, tmp_path) == []
