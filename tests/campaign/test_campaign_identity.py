"""What a run is known by: all that its numbers come from."""

from __future__ import annotations

import sys

import pytest
from campaign_bench import quick

from orchestrator.campaign import product as products
from orchestrator.config import load_config
from orchestrator.run import prepare

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


def through(effect, **options):
    """The loop with an effect on the force, and the path of the effect."""
    data = load_config("docking-1d-uncompensated").model.to_data()
    data.pop("bonds", None)
    number = next(n for n, one in enumerate(data["connections"]) if str(one).endswith("-> satellite.force"))
    source, _, target = str(data["connections"][number]).partition("->")
    entry = {"from": source.strip(), "to": target.strip(), "through": [{"effect": effect, **options}]}
    data["connections"][number] = entry
    return data, f"connections[{number}].through[0].effect"


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
        return [study.task(n)[0].key for n in range(2)]

    one = keys()
    assert len(set(one)) == 2 and one == keys()
    modules("campaign_law_other.py", _MODULE.format(imports="", factor=0.7))
    assert keys()[0] == one[0] and keys()[1] != one[1]


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
        ("diagnosis/ports/laws.py", True),  # can stand in a config
        ("campaign/derived.py", True),
        ("campaign/execute.py", True),
        ("diagnosis/verdict.py", False),
        ("campaign/reading.py", False),
    ],
)
def test_the_product_is_known_by_what_computes(sources, place, counts):
    assert (sources(place) != sources()) == counts


def test_effects_of_the_product_are_counted_once_and_others_of_its_modules_by_themselves():
    law = through(
        "orchestrator.diagnosis.ports.laws:Viscous",
        read={"velocity": "satellite.velocity"},
        damping="1 N.s/m",
    )
    assert products.effect_sources(prepare(law[0]).system) == []
    played = through("orchestrator.diagnosis.ports.playback:Release")
    assert len(products.effect_sources(prepare(played[0]).system)) == 1
