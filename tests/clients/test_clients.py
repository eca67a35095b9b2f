"""What we ship and export gives in tools that we did not write what it gives here."""

from __future__ import annotations

import math
from importlib.util import find_spec

import pytest

from tests.clients import matrix
from tests.clients.job import Job, deviation
from tests.clients.limits import limit_of
from tests.clients.masters import CLIENTS
from tests.clients.subjects import GROUPS

pytestmark = pytest.mark.skipif(
    find_spec("ziglang") is None, reason="building the source of signals needs ziglang"
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("clients")


@pytest.fixture(scope="module", params=list(CLIENTS))
def found(request, folder):
    """A client, and what it makes of everything."""
    if why := CLIENTS[request.param].absent():
        pytest.skip(why)
    return request.param, matrix.collect(request.param, folder)


def test_everything_agrees_or_is_a_known_limit_of_the_client(found):
    client, outcomes = found
    beyond = {
        f"{group}: {name}": outcome
        for group, jobs in outcomes.items()
        for name, outcome in jobs.items()
        if not outcome.agrees and limit_of(client, name, outcome) is None
    }
    assert beyond == {}
    assert sum(outcome.agrees for jobs in outcomes.values() for outcome in jobs.values()) > 20


def test_the_document_says_what_came_out(found):
    client, outcomes = found
    rows = matrix.rows_of(matrix.DOCUMENT.read_text(encoding="utf-8"), client)
    if rows is None:
        pytest.skip("the document does not show this version of the client")
    assert rows == {group: matrix.cell(outcomes[group]) for group in GROUPS}


def test_a_difference_is_a_difference():
    job = Job("", (), (), 1.0, 2, ("a.x", "a.y"))
    ours = {"a.x": [0.0, 1.0, 2.0], "a.y": [0.0, -4.0, 0.0]}
    assert deviation(job, {"a.x": [1.0, 2.0], "a.y": [-4.0, 0.0]}, ours) == (0.0, "")
    assert deviation(job, {"a.x": [1.0, 2.0], "a.y": [-3.0, 0.0]}, ours) == (0.25, "a.y")
    for other in ([1.0, math.nan], [1.0], [1.0, 2.0, 3.0]):
        assert deviation(job, {"a.x": other, "a.y": [-4.0, 0.0]}, ours) == (math.inf, "a.x")
    assert deviation(job, {"a.x": [1.0, 2.0]}, ours) == (math.inf, "a.y")
