"""Errors cross processes whole."""

from __future__ import annotations

import pickle

import pytest

from orchestrator.base.errors import BuildError, ConfigError, FmuError, Problem, StepError
from orchestrator.fmi.workers.child import KilledError


@pytest.mark.parametrize(
    "error",
    [
        ConfigError([Problem("a.yaml:3: run", "got 1", "2", "Ask."), Problem("", "another")]),
        StepError("broke", instance="body", time=0.5, status="error", log=("one", "two"), remedy="Halve it."),
        StepError("broke", instance="body", time=None, status="discard"),
        FmuError("body.fmu: no model"),
        BuildError("line 3"),
        KilledError("a worker was killed"),
    ],
    ids=lambda one: type(one).__name__,
)
def test_an_error_comes_from_another_process_as_it_was(error):
    sent = pickle.loads(pickle.dumps(error))
    assert type(sent) is type(error)
    assert str(sent) == str(error)
    assert vars(sent) == vars(error)


def test_a_long_list_of_what_is_allowed_is_printed_once():
    many, few = "bundled FMUs: " + ", ".join(f"Fmu{k}" for k in range(60)), "a number"
    error = ConfigError([Problem(f"x.yaml:{k}", "no file", tail) for tail in (many, few) for k in (1, 2)])
    assert str(error).splitlines() == [
        "x.yaml:1: no file", f"  {many}", "x.yaml:2: no file",
        "x.yaml:1: no file", f"  {few}", "x.yaml:2: no file", f"  {few}",
    ]  # fmt: skip
