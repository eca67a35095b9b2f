"""Whether a model is stiff: whether an explicit method would take far more steps than an implicit one."""

from __future__ import annotations

from itertools import pairwise

import casadi as ca
import numpy as np
from scipy.sparse import csc_matrix

from .generate import variable_table
from .program import Program

_STABLE = 3.3  # the explicit method is stable where the step times an eigenvalue is below this
_POINTS = 30  # of the experiment at which eigenvalues are looked at
_MOST_STATES = 1000  # of a nonlinear model that is followed through the experiment; else its start counts
_FEW_STATES = 60
_LEAST_STEPS = 1000  # that any method takes
_TIMES = 20
_ROUNDS = 10


def explicit_steps(program: Program, stop: float) -> int:
    """Steps of an explicit method over an experiment for stability alone, if an implicit one would save most.

    Eigenvalues are looked at along a solution by CVODE, with inputs at their start values.

    Args:
        stop: length of the experiment [s].
    Returns: 0 for a model that is not stiff, or whose solution CVODE does not find.
    """
    n = len(program.states)
    if not n or program.model.delays:
        return 0
    point = _Point(program)
    slope = point.slope
    matrix = ca.jacobian(slope, point.x)
    jacobian = ca.Function("j", [point.t, point.x, point.modes], [matrix])
    x, most = point.start, _LEAST_STEPS
    try:
        if not ca.depends_on(matrix, ca.vertcat(point.t, point.x, point.modes)) or n > _MOST_STATES:
            found = _fastest(jacobian(0, x, point.modes_at(0, x))) * stop / _STABLE
        else:
            begin, length = ca.SX.sym("begin"), ca.SX.sym("length")
            now = begin + length * point.t
            (moved,) = ca.substitute([length * slope], [point.t], [now])
            problem = {
                "x": point.x, "t": point.t, "p": ca.vertcat(begin, length, point.modes), "ode": moved,
            }  # fmt: skip
            options = {"reltol": 1e-6, "abstol": 1e-9, "max_num_steps": 10_000, "show_eval_warnings": False}
            solver = ca.integrator("s", "cvodes", problem, 0, 1, options)
            found, steps = 0.0, 0
            late = np.geomspace(1e-6, 1, _POINTS // 2) * stop
            times = np.unique(np.concatenate([[0.0], late, np.linspace(0, stop, _POINTS // 2)]))
            for a, b in pairwise(times):
                modes = point.modes_at(a, x)
                x = solver(x0=x, p=ca.vertcat(a, b - a, modes))["xf"]
                steps += int(solver.stats().get("nsteps", 0))
                found += _fastest(jacobian(b, x, modes)) * (b - a) / _STABLE
            most = max(most, steps)
    except (RuntimeError, np.linalg.LinAlgError):
        return 0
    return int(found) if np.isfinite(found) and found > _TIMES * most else 0


class _Point:
    """The derivatives of a program in symbols of time, states and modes; the rest has its start value."""

    def __init__(self, program: Program) -> None:
        self._program = program
        table = variable_table(program)
        groups: dict[str, list[float]] = {"INPUT": [0.0] * len(program.inputs)}
        groups["PARAMETER"] = [0.0] * len(program.parameters)
        groups["STATE"] = [0.0] * len(program.states)
        for one in table:
            if one.kind in groups and one.start is not None:
                groups[one.kind][one.index] = one.start
        p = groups["PARAMETER"]
        for name, value in zip(program.dependent, _numbers(program.dependent_parameters(p)), strict=True):
            p[program.parameters.index(name)] = float(value)
        for name, value in zip(program.started, _numbers(program.dependent_starts(p)), strict=True):
            groups["STATE"][program.states.index(name)] = float(value)
        self._u, self._p, self.start = groups["INPUT"], p, ca.DM(groups["STATE"])
        self._count = len(program.model.relations)
        self.t, self.x = ca.SX.sym("t"), ca.SX.sym("x", len(program.states))
        self.modes = ca.SX.sym("m", self._count)
        self.slope = program.derivatives(self.t, self.x, self._u, self._p, [], self.modes)

    def modes_at(self, time: float, x: ca.DM) -> list[float]:
        modes = [0.0] * self._count
        for _ in range(_ROUNDS if self._count else 0):
            values = _numbers(self._program.relations(time, x, self._u, self._p, [], modes))
            found = [float(value >= 0) for value in values]
            if found == modes:
                break
            modes = found
        return modes


def _numbers(found: ca.DM) -> list[float]:
    return [float(one) for one in found.full().ravel()]


def _fastest(jacobian: ca.DM) -> float:
    """The fastest decay [1/s]; of many states the largest eigenvalue of the matrix of absolute values.

    Neither depends on the units of the states, as norms do.
    """
    if jacobian.size1() <= _FEW_STATES:
        return max(0.0, float(-np.linalg.eigvals(jacobian.full()).real.min()))
    matrix = abs(csc_matrix(jacobian.sparse()))
    vector = np.ones(matrix.shape[0])
    found = 0.0
    for _ in range(100):
        moved = matrix @ vector
        before, found = found, float(np.abs(moved).max())
        if not found or not np.isfinite(found) or abs(found - before) < 1e-2 * found:
            break
        vector = moved / found
    return found
