"""Expressions of derived numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orchestrator.campaign.derived import Derived
from orchestrator.campaign.execute import flat
from orchestrator.results.recorders import Results

TIME = np.linspace(0.0, 1.0, 101)
RESULTS = Results(TIME, {"a.y": np.sin(TIME), "a.q[1]": TIME**2, "a.q[1,2]": -TIME}, {}, {"a.k": 4.0})
MEASURED = {"contacts": [{"cor": 0.5}, {"cor": 0.25}], "estimate": 7, "text": "x", "none": None}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("max(a.y)", math.sin(1.0)),
        ("min(-a.y)", -math.sin(1.0)),
        ("rms(a.y - a.y)", 0.0),
        ("final(a.q[1]) + first(a.q[1,2])", 1.0),
        ("max(abs(a.q[1,2]) * 2)", 2.0),
        ('at(a.q[1], "500 ms")', 0.25),
        ("integral(2 * time)", 1.0),
        ("time_of_max(a.y)", 1.0),
        ("contacts[1].cor / contacts[0].cor", 0.5),
        ("estimate ** 2 - 1", 48.0),
        ("sqrt(a.k)", 2.0),
        ("'contacts[0].cor'", 0.5),
        ("max(1)", 1.0),
        ("contacts[5].cor", None),
        ("text", None),
        ("none + 1", None),
        ("1 / 0", None),
        ("log(-1)", None),
        ('at(a.y, "2 s")', None),
    ],
)
def test_expressions(text, value):
    found = Derived("x", text).value(RESULTS, MEASURED)
    assert found == (None if value is None else pytest.approx(value, abs=1e-12))


@pytest.mark.parametrize(
    "text",
    [
        "", "a.y.__class__()", "(lambda: 1)()", "[1, 2]", "max(a.y, a.y)", "max(max(a.y))",
        "a.y if a.y else 1", "9**999", "2**a.k", "at(a.y, 0.5)", 'at(a.y, "5 kg")', "f'{1}'", "a.y[x]",
        "max(key=1)", "1e999",
        "1 < 2", "x := 1", "(" * 500, "+".join(["1"] * 900), "-" * 1500 + "1", "open('x')",
    ],
)  # fmt: skip
def test_what_is_no_expression_is_refused(text):
    with pytest.raises(ValueError):
        Derived("x", text)


@settings(max_examples=200, deadline=None)
@given(st.text("abcmaxin()[].,+-*/0123456789 '\"_", max_size=60))
def test_any_text_is_an_expression_or_refused(text):
    try:
        made = Derived("x", text)
    except ValueError:
        return
    assert made.value(RESULTS, MEASURED) is None or math.isfinite(made.value(RESULTS, MEASURED))


def test_numbers_of_a_summary_go_by_their_paths():
    assert flat({"a": [{"b": 1, "c": "x"}, None, True], "d": 2.5}) == [("a[0].b", 1.0), ("d", 2.5)]
