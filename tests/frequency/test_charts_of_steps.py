"""Charts with the communication step on an axis, and the source's points on charts."""

import numpy as np
import pytest

from orchestrator.base.errors import ConfigError
from orchestrator.frequency import Loop, chart, sample, sampled_chart, source_points

PLAIN = "docking-1d-uncompensated"
STEPS = np.array([2e-4, 1e-3, 1.5e-3])
DAMPING = np.array([0.0, 1200.0, 3000.0])


def test_every_point_is_the_sampled_loop():
    loop = Loop.of(PLAIN)
    drawn = sampled_chart(loop, "jacobi", ("contact.damping", DAMPING), ("run.step_size", STEPS))
    turned = sampled_chart(loop, "jacobi", ("run.step_size", STEPS), ("contact.damping", DAMPING))
    np.testing.assert_array_equal(turned.growth, drawn.growth.T)
    np.testing.assert_array_equal(turned.unstable, drawn.unstable.T)
    one = sample(loop.with_parameters({"contact.damping": 1200.0}), "jacobi", 1e-3)
    assert drawn.growth[1, 1] == one.growth()
    np.testing.assert_array_equal(drawn.stable, drawn.growth < 1)
    # At 1200 N.s/m, stable in the limit, a step of 1 ms is too long for jacobi but not for gauss-seidel.
    assert list(drawn.stable[:, 1]) == [True, False, False]
    other = sampled_chart(loop, "gauss-seidel", ("contact.damping", DAMPING), ("run.step_size", STEPS))
    assert list(other.stable[:, 1]) == [True, True, True]


def test_one_axis_is_the_step():
    with pytest.raises(ConfigError) as caught:
        sampled_chart(Loop.of(PLAIN), "jacobi", ("robot.tau_m", [1e-3]), ("contact.damping", [0.0]))
    assert str(caught.value) == (
        f"{PLAIN}: the axes are robot.tau_m and contact.damping\n"
        "  exactly one is to be run.step_size. Without it: chart."
    )


def test_points_of_the_source_lie_where_all_else_agrees():
    across, up = np.linspace(0, 8e-3, 3), np.linspace(0, 2000, 3)

    def points(*overrides: str):
        return source_points(
            chart(Loop.of(PLAIN, overrides), ("robot.tau_m", across), ("contact.damping", up))
        )

    assert points() == {"source, 2 ms": (2e-3, 0.0), "source, 6 ms": (6e-3, 0.0)}
    assert points("robot.xi_n=0.7") == {}
    stiffness = ("contact.stiffness", np.linspace(50e3, 200e3, 3))
    found = source_points(chart(Loop.of(PLAIN), stiffness, ("contact.damping", up)))
    assert found == {"source, 2 ms": (176e3, 0.0), "source, 70 N/mm": (70e3, 100.0)}
