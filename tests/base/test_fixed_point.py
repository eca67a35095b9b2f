"""Solvers of x = F(x) on problems whose solution is known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.base.fixed_point import Anderson, FixedPoint, Newton, solve

ONE = np.ones(1)


def run(function, start, solver, tolerance=1e-10, limit=50, **options):
    start = np.atleast_1d(np.array(start, float))
    return solve(
        function, start, np.ones(len(start)), solver, tolerance=tolerance, max_iterations=limit, **options
    )


@pytest.mark.parametrize("gain", [-1e5, -50.0, -1.0, 0.5, 0.99, 50.0, 1e5])
def test_newton_solves_linear_loops_of_any_gain_in_three_iterations(gain):
    found = run(lambda x: gain * x + 1.0, 0.0, Newton(ONE))
    assert found.converged and found.iterations <= 3
    assert found.x[0] == pytest.approx(1.0 / (1.0 - gain), rel=1e-9)


@pytest.mark.parametrize("gain", [-50.0, 0.99, 50.0])
def test_anderson_solves_linear_loops_that_a_fixed_point_does_not(gain):
    found = run(lambda x: gain * x + 1.0, 0.0, Anderson(ONE))
    assert found.converged and found.iterations <= 5
    assert found.x[0] == pytest.approx(1.0 / (1.0 - gain), rel=1e-8)
    assert not run(lambda x: gain * x + 1.0, 0.0, FixedPoint()).converged


def test_a_fixed_point_contracts_by_the_gain_and_relaxation_turns_a_negative_one():
    found = run(lambda x: 0.1 * x + 1.0, 0.0, FixedPoint(), tolerance=1e-6)
    assert found.iterations == 7  # 0.1**6 = 1e-6 after the first, which gives 1
    # 1 - w (1 + 3) = 0.2: -3 is made to contract.
    found = run(lambda x: -3.0 * x + 1.0, 0.0, FixedPoint(0.2))
    assert found.converged and found.x[0] == pytest.approx(0.25, abs=1e-9)


@given(
    st.lists(st.floats(-3.0, 3.0), min_size=9, max_size=9),
    st.lists(st.floats(-5.0, 5.0), min_size=3, max_size=3),
)
def test_newton_solves_linear_systems(entries, right):
    matrix, right = np.array(entries).reshape(3, 3), np.array(right)
    values = np.linalg.svd(matrix - np.eye(3), compute_uv=False)
    found = run(lambda x: matrix @ x + right, np.zeros(3), Newton(np.ones(3)))
    if values[-1] > 1e-3:
        assert found.converged
        assert found.x == pytest.approx(np.linalg.solve(np.eye(3) - matrix, right), rel=1e-5, abs=1e-6)


@pytest.mark.parametrize(("function", "solution"), [
    (np.cos, 0.7390851332151607),  # Dottie's number
    (lambda x: x - np.arctan(x), 0.0),  # undamped Newton runs away from |x| > 1.3917
    (lambda x: np.where(x > 0.1, -1e3 * (x - 0.1), 0.0) + 0.2, 0.1 + 0.1 / 1001.0),  # a contact
])  # fmt: skip
def test_newton_solves_what_is_not_linear(function, solution):
    found = run(function, 3.0, Newton(ONE), tolerance=1e-9)
    assert found.converged and found.x[0] == pytest.approx(solution, abs=1e-8)


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_units_of_the_components_do_not_matter(unit):
    # A contact of 176 N/mm against a rod of compliance 1e-5 m/N: a loop gain of -1.76.
    slope = np.array([[0.0, -176e3 * unit], [1e-5 / unit, 0.0]])
    nominal = np.array([unit, 1.0])
    found = solve(
        lambda x: slope @ x + np.array([0.0, 1.0]), np.zeros(2), nominal, Newton(nominal),
        tolerance=1e-10, max_iterations=20,
    )  # fmt: skip
    assert found.converged and found.x[1] == pytest.approx(1.0 / 2.76, rel=1e-8)


def test_the_slope_is_carried_over_to_the_next_problem():
    calls = []

    def function(x, shift):
        calls.append(x)
        return -50.0 * x + shift

    solver = Newton(ONE)
    run(lambda x: function(x, 1.0), 0.0, solver)
    calls.clear()
    assert run(lambda x: function(x, 2.0), 1.0 / 51.0, solver).iterations == len(calls) == 2


@pytest.mark.parametrize("start", [0.0, 1e6])
def test_a_loop_of_gain_one_has_no_solution_and_none_is_given(start):
    found = run(lambda x: x + 1.0, start, Newton(ONE))
    assert not found.converged and "loop gain is 1" in found.why
    assert not run(lambda x: x + 1.0, start, Anderson(ONE), tolerance=1e-12).converged


def test_what_grows_beyond_bounds_is_reported():
    with np.errstate(over="ignore"):  # which is what this provokes
        found = run(lambda x: 1e200 * x + 1.0, 1.0, FixedPoint())
    assert not found.converged and found.iterations == 2
    assert found.why == "the values grow beyond all bounds"


def test_components_that_are_discrete_are_passed_on_and_must_agree():
    def function(x):
        return np.array([-50.0 * x[0] + x[1], float(x[0] < 0.5)])

    found = run(function, [3.0, 0.0], Newton(ONE), discrete=np.array([False, True]))
    assert found.converged and found.x == pytest.approx([1.0 / 51.0, 1.0], rel=1e-9)
    never = run(lambda x: 1.0 - x, 0.0, Newton(ONE), discrete=np.array([True]))
    assert not never.converged and never.iterations == 50


def test_the_last_evaluation_is_the_one_that_is_given():
    seen = []

    def function(x):
        seen.append(x.copy())
        return np.array([np.cos(x[1]), np.sin(x[0])])

    found = run(function, [0.0, 0.0], Newton(np.ones(2)))
    assert seen[-1].tolist() == found.x.tolist() and function(found.x).tolist() == found.value.tolist()
