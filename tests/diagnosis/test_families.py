"""Laws that are nested in each other split a clear cause's probability: they are reported together."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from test_report import made

from orchestrator.diagnosis.rig.diagnosed import Diagnosed
from orchestrator.diagnosis.rig.families import Kin, families_of, together
from orchestrator.diagnosis.rig.headline import headline
from orchestrator.diagnosis.rig.report import compose
from orchestrator.diagnosis.rig.report_text import text

DRY, LAG = Kin("dry friction", "drive"), Kin("a lag", "drive.voltage")
KIN = {f"drive.{one}": DRY for one in ("coulomb", "stribeck", "dahl")}
KIN |= {f"drive.voltage.{one}": LAG for one in ("delay", "low-pass")}
SPLIT = {("drive.coulomb",): 0.43, ("drive.stribeck",): 0.31, ("drive.dahl",): 0.26}


def told(shares, verdict=None, ties=(), **other):
    """A diagnosis whose answers have these probabilities, the first given if no other is."""
    which = [
        {
            "effects": list(effects),
            "probability": share,
            "parameters": {},
            "ties": list(ties) if not at else [],
        }
        for at, (effects, share) in enumerate(shares.items())
    ]
    answers = [SimpleNamespace(**one) for one in which]
    families = [
        {"name": one.name, "place": one.place, "probability": whole, "members": members}
        for one, (whole, members) in families_of(answers, KIN).items()
    ]
    effects = next(iter(shares)) if verdict is None else verdict
    return made(effects=list(effects), which=which, families=families, **other)


def test_forms_of_a_cause_are_told_together_where_none_is_clear_alone():
    found = told(SPLIT)
    assert headline(found) == (
        "Dry friction at drive causes the gap (probability 100 %; these logs do not show which form: "
        "coulomb 43 %, stribeck 31 %, dahl 26 %); adding drive.coulomb closes 98 % of the gap on runs that "
        "no fit saw."
    )
    assert found.verdict.effects == ["drive.coulomb"] and found.which[0].probability == 0.43
    assert found.families[0].members == pytest.approx({name[0]: share for name, share in SPLIT.items()})
    line = "dry friction at drive, 100 %; which: coulomb 43 %, stribeck 31 %, dahl 26 %"
    assert f"  together: {line}" in text(Diagnosed(None, None, found)).splitlines()
    assert f"<p class=note>Together: {line}</p>" in compose(found, {}, [], {}, "held-out runs")


def test_a_form_that_is_clear_alone_is_named():
    found = told({("drive.coulomb",): 0.96, ("drive.dahl",): 0.04})
    assert headline(found).startswith("drive.coulomb causes the gap (probability 96 %); adding it closes")
    assert "  together: dry friction at drive, 100 %; which: coulomb 96 %, dahl 4.0 %" in text(
        Diagnosed(None, None, found)
    )
    unclear = told({("drive.coulomb",): 0.4, ("drive.dahl",): 0.3, ("drive.viscous",): 0.3})
    assert headline(unclear).startswith("drive.coulomb causes the gap (probability 40 %)")
    assert unclear.families[0].probability == pytest.approx(0.7)


def test_what_acts_beside_a_form_is_told_by_itself():
    lag, beside = ("drive.coulomb", "drive.voltage.delay"), ("drive.voltage.gain", "drive.coulomb")
    found = told({lag: 0.5, ("drive.dahl", "drive.voltage.low-pass"): 0.4, ("drive.voltage.gain",): 0.1})
    assert headline(found).startswith(
        "Dry friction at drive and a lag at drive.voltage cause the gap (probability 90 %; these logs do not "
        "show which form: coulomb 50 %, dahl 40 %; delay 50 %, low-pass 40 %); adding drive.coulomb and "
        "drive.voltage.delay closes"
    )
    found = told(
        {beside: 0.6, ("drive.dahl", "drive.voltage.gain"): 0.4}, ties=("drive.stribeck", "x.offset")
    )
    said = headline(found)
    assert said.startswith("drive.voltage.gain and dry friction at drive cause the gap (probability 100 %;")
    assert "coulomb 60 %, dahl 40 %)" in said
    assert said.endswith(
        " These logs cannot separate drive.voltage.gain and drive.coulomb from drive.stribeck or x.offset."
    )


def test_a_clear_cause_is_told_beside_another_answer():
    shares = {(): 0.19, ("drive.coulomb",): 0.18, ("drive.dahl",): 0.18, ("drive.stribeck",): 0.18}
    pairs = {("drive.coulomb", "drive.voltage.delay"): 0.14, ("drive.dahl", "drive.voltage.delay"): 0.13}
    found = told(shares | pairs, ties=())
    assert headline(found).endswith(
        " Likelier is dry friction at drive, its forms taken together (81 %: coulomb 32 %, dahl 31 %, "
        "stribeck 18 %)."
    )
    assert "Likelier" not in headline(told({(): 0.4, ("drive.coulomb",): 0.3, ("drive.dahl",): 0.3}))


def test_answers_that_differ_by_the_form_of_a_cause_count_together():
    answers = [
        SimpleNamespace(effects=effects, probability=share)
        for effects, share in ((("a", "b"), 0.5), (("b", "c"), 0.3), (("a",), 0.1), ((), 0.1))
    ]
    kin = {"a": Kin("x", "p"), "c": Kin("x", "p")}
    assert together(("a", "b"), answers, kin) == (0.8, {"a": 0.5, "c": 0.3})
    assert together((), answers, kin) == (0.1, {})
    assert families_of(answers, kin) == {Kin("x", "p"): (0.9, {"a": 0.6, "c": 0.3})}
    assert families_of(answers, {"a": Kin("x", "p")}) == {}  # one form alone is no family
