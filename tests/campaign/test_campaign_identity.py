"""What a run is known by: all that its numbers come from."""

from __future__ import annotations

import sys

import pytest
import yaml
from campaign_bench import QUICK, one_body, quick, through, with_mass_in

from orchestrator.campaign import Study
from orchestrator.campaign import software_version as products
from orchestrator.config import dump
from orchestrator.simulation.run import prepare

_MODULE = '''
from typing import ClassVar
from orchestrator.effects import Effect
{imports}

class Scaled(Effect):
    """Part of the force."""
    jittable: ClassVar[bool] = True

    @staticmethod
    def kernel(time, x, options, memory, commit):
        return {factor} * x[0]
'''
_ALIKE = _MODULE.format(imports="", factor=0.9)


@pytest.fixture
def modules(tmp_path, monkeypatch):
    """Writes modules that can be imported, and forgets those that were."""
    folder = tmp_path / "installed"
    folder.mkdir()
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)

    def write(name, text):
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
        forget()

    def forget():
        for one in [one for one in sys.modules if one.partition(".")[0].startswith("campaign_law")]:
            del sys.modules[one]

    yield write
    forget()


def test_a_run_is_made_again_when_the_code_of_its_effect_has_changed(modules, tmp_path):
    def swept(factor):
        modules("campaign_law.py", _MODULE.format(imports="", factor=factor))
        data, _ = through("campaign_law:Scaled")
        study = quick(system=data, design={"grid": {"robot.tau_m": ["4 ms"]}}, step_halving=False)
        return study.run(tmp_path / "store", jobs=1)

    first, other, again = swept(0.5), swept(0.9), swept(0.5)
    assert (first.made, other.made, again.made) == (1, 1, 0)
    assert first.columns()["peak"][0] != other.columns()["peak"][0]
    assert first.columns()["peak"][0] == again.columns()["peak"][0]


def key(data, **changes):
    changes = {"design": {"grid": {"robot.tau_m": ["4 ms"]}}} | changes
    return quick(system=data, **changes).task(0)[0].key


def test_an_effect_of_a_package_is_known_by_all_of_the_package(modules):
    init, law = "campaign_laws/__init__.py", "campaign_laws/law.py"
    text = _MODULE.format(imports="from .numbers import FACTOR", factor="FACTOR")
    modules(init, "")
    modules(law, text)
    modules("campaign_laws/numbers.py", "FACTOR = 0.5\n")
    data, _ = through("campaign_laws.law:Scaled")
    one = key(data)
    assert one == key(data)
    modules("campaign_laws/numbers.py", "FACTOR = 0.9\n")
    assert one != key(data)


def test_an_effect_that_is_derived_from_another_is_known_by_both(modules):
    modules("campaign_law_base.py", _MODULE.format(imports="", factor=0.5))
    modules(
        "campaign_law.py", "import campaign_law_base\nclass Own(campaign_law_base.Scaled):\n    '''Same.'''\n"
    )
    data, _ = through("campaign_law:Own")
    one = key(data)
    modules("campaign_law_base.py", _ALIKE)
    assert one != key(data)


def test_effects_that_a_design_varies_are_known_by_their_code(modules):
    modules("campaign_law.py", _MODULE.format(imports="", factor=0.5))
    modules("campaign_law_other.py", _ALIKE)
    data, path = through("campaign_law:Scaled")

    def keys():
        study = quick(
            system=data, design={"grid": {path: ["campaign_law:Scaled", "campaign_law_other:Scaled"]}}
        )
        return study.id, *(study.task(n)[0].key for n in range(2))

    one = keys()
    assert len(set(one)) == 3 and one == keys()
    modules("campaign_law_other.py", _MODULE.format(imports="", factor=0.7))
    # The study is another, too: its points in a store hold the keys.
    assert [a == b for a, b in zip(keys(), one, strict=True)] == [False, True, False]


def test_files_of_effects_that_a_design_varies_are_beside_the_study(tmp_path):
    """Not beside its system, nor in the working directory of the process that makes the runs."""
    mine, theirs = tmp_path / "mine", tmp_path / "theirs"
    for folder, factor in ((mine, 0.5), (theirs, 0.9)):
        folder.mkdir()
        (folder / "laws.py").write_text(_MODULE.format(imports="", factor=factor))
    data, path = through("laws.py:Scaled")
    (theirs / "system.yaml").write_text(dump(data))
    study = {
        "format": "sweep/1",
        "set": QUICK,
        "design": {"grid": {path: ["laws.py:Scaled"]}},
        "derived": {"peak": "max(abs(contact.force))"},
        "step_halving": False,
    }
    peaks = []
    for folder in (theirs, mine):
        (folder / "study.yaml").write_text(dump(study | {"system": "../theirs/system.yaml"}))
        swept = Study.load(folder / "study.yaml").run(tmp_path / "store", jobs=1)
        assert swept.made == 1 and not swept.failed
        peaks.append(swept.columns()["peak"][0])
    assert peaks[0] != peaks[1]


@pytest.fixture
def sources(monkeypatch):
    """The product's digest, as it is if a file were another."""

    def digest(place=None):
        products.product.cache_clear()
        read = products.Path.read_bytes
        changed = None if place is None else products._PACKAGE / place
        assert changed is None or changed.is_file()
        with monkeypatch.context() as patch:
            patch.setattr(products.Path, "read_bytes", lambda path: read(path) + b"#" * (path == changed))
            return products.product()

    yield digest
    products.product.cache_clear()


@pytest.mark.parametrize(
    ("place", "counts"),
    [
        ("master/jacobi.py", True),
        ("campaign/derived.py", True),
        ("campaign/execute.py", True),
        ("diagnosis/rig/verdict.py", False),
        ("campaign/database.py", False),
    ],
)
def test_the_product_is_known_by_what_computes(sources, place, counts):
    assert (sources(place) != sources()) == counts


def test_effects_of_the_product_are_counted_once_and_others_of_its_modules_by_themselves():
    own = through("gain", factor=2.0)
    assert products.effect_sources(prepare(own[0]).system) == []
    played = through("orchestrator.diagnosis.study.playback:Playback")
    assert len(products.effect_sources(prepare(played[0]).system)) == 1


@pytest.fixture
def bodies(tmp_path):
    """One body as two FMUs, which have its mass in kg and in g."""
    kilograms = with_mass_in("kg", tmp_path / "kilograms.fmu", "280")
    return kilograms, with_mass_in("g", tmp_path / "grams.fmu", "280000")


def test_start_values_are_in_the_units_of_the_fmu_that_a_point_has(bodies, tmp_path):
    kilograms, grams = bodies
    grid = {"m.mass": ["100 kg", "2e5 g"], "m.fmu": [str(one) for one in bodies]}
    study = one_body(kilograms, design={"grid": grid})
    columns = study.run(tmp_path / "store", jobs=1).columns()
    assert columns["m.mass"].tolist() == [100.0, 100.0, 200.0, 200.0]  # in the axis's unit
    assert columns["mass"].tolist() == [100.0, 100000.0, 200.0, 200000.0]  # in that of each FMU
    # The same runs, made from the other side.
    grid = {"m.fmu": [str(one) for one in bodies], "m.mass": ["0.1 t", "200 kg"]}
    other = one_body(grams, design={"grid": grid}).run(tmp_path / "store", jobs=1)
    assert (other.made, other.reused) == (0, 4)
    assert other.columns()["mass"].tolist() == [100.0, 200.0, 100000.0, 200000.0]


def _weighing(fmu, mass, **grid):
    """The identity of a run whose config gives the mass."""
    design = {"grid": {"run.step_size": ["10 ms"], **grid}}
    system = one_body(fmu, design=design).prepared.config.model.to_data()
    system["instances"]["m"]["start"]["mass"] = mass
    return one_body(fmu, system=system, design=design).task(0)[0].key


def test_start_values_of_the_system_are_distinguished_by_the_unit_of_the_fmu_that_a_point_has(bodies):
    kilograms, grams = bodies
    varied = _weighing(kilograms, "100 kg", **{"m.fmu": [str(grams)]})
    assert varied == _weighing(grams, "1e5 g")
    assert varied != _weighing(grams, "100 g")


def test_a_start_value_that_an_fmu_of_the_design_does_not_take_is_a_failure_of_its_runs(tmp_path):
    kilograms = with_mass_in("kg", tmp_path / "kilograms.fmu", "280")
    light = with_mass_in("g", tmp_path / "light.fmu", "10", 'min="0" max="1000"')
    points = [
        {"m.fmu": str(kilograms), "m.mass": "1 kg"},
        {"m.fmu": str(light), "m.mass": "2 kg"},
        {"m.fmu": str(light), "m.mass": "1 kg"},
    ]
    columns = one_body(kilograms, design={"list": points}).run(tmp_path / "store", jobs=1).columns()
    assert columns["kind"].tolist() == ["", "config", ""]
    assert "m.mass = 2.0 kg is out of range" in columns["message"][1]
    assert columns["mass"][2] == 1000.0


@pytest.mark.parametrize("varied", ["satellite.form", "satellite.fmu"])
def test_a_study_over_fmus_finds_its_effects_wherever_it_is_loaded(varied, tmp_path, monkeypatch):
    folder, elsewhere = tmp_path / "study", tmp_path / "elsewhere"
    folder.mkdir()
    elsewhere.mkdir()
    (folder / "laws.py").write_text(_MODULE.format(imports="", factor=0.5))
    data, _ = through("laws.py:Scaled")
    (folder / "system.yaml").write_text(yaml.safe_dump(data, sort_keys=False))
    with_mass_in("kg", folder / "own.fmu", "280")
    values = {"satellite.form": ["python", "native"], "satellite.fmu": ["own.fmu", "SatelliteDynamics"]}[
        varied
    ]
    study = {
        "format": "sweep/1",
        "system": "system.yaml",
        "set": {"run.stop_time": "0.1 s"},
        "design": {"grid": {varied: values}},
        "step_halving": False,
    }
    (folder / "study.yaml").write_text(yaml.safe_dump(study))
    monkeypatch.chdir(elsewhere)
    swept = Study.load(folder / "study.yaml").run(tmp_path / "store", jobs=1)
    assert (swept.made, swept.failed) == (2, {})
