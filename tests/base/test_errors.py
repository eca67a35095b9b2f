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
