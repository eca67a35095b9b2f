"""Where a system is stable over two of its parameters, and the border between.

Roots are counted on a coarse grid, and finer in cells that the border passes or may pass: where the real part
of a root could reach 0 at the rate that it has at the corners. On the sides of the finest cells the border is
where the exact root of the equation has the real part 0. With the communication step as a parameter the
eigenvalues of the sampled system are counted, and the border is found by bisection.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from ..base.arrays import Array, Complex
from ..base.errors import ConfigError, OrchestratorError, Problem
from ..base.quantities import Measure, quantity
from ..base.units import parse_unit
from ..fmi import Value
from ..simulation.run import Prepared, prepare
from .chart_report import Chart
from .delay_system import DelaySystem
from .family import Family
from .from_system import Linearised, linearise
from .over_parameter import STEP, ParameterRange
from .sampled_system import sampled_system
from .step_report import resting_roots, with_step
from .trim import trim

# Points of a delay in the discretisation that counts roots; how many counts are compared with the highest
# order, and how many with the argument principle.
_ORDERS = (10, 16, 28, 48)
_COMPARED, _CHECKED = 24, 8
# Cells of the first grid along either axis; each is divided in two until the grid is fine.
_CELLS = 25
# A root may move from a corner by this many times what its slope makes of a cell: more than to the middle.
_AHEAD = 0.75
# Roots whose slopes are looked at, and the share of the range that the slopes are taken over.
_WATCHED = 12
_APART = 1e-5


class Look(NamedTuple):
    """What is known at a point.

    Attributes:
        unstable: how many roots grow.
        root: the dominant one that is not 0.
        levels: real parts of the rightmost roots, shape (k,) [rad/s].
        slopes: by how much they change over the range of either parameter, shape (k, 2); None: not known.
    """

    unstable: int
    root: complex
    levels: Array
    slopes: Array | None = None


State = Callable[[float, float, bool], Look]


def chart_of(
    make: Callable[[float, float], DelaySystem],
    x: tuple[float, float],
    y: tuple[float, float],
    points: int = 200,
) -> Chart:
    """A chart of any family of systems.

    Args:
        make: the system of two values.
        x, y: smallest and largest value.
        points: along either axis.
    Raises: ConfigError if the parameters change what the system consists of; OrchestratorError if roots
        cannot be counted.
    """
    family = Family(make, (x, y))
    order = _trusted_order(family, x, y)

    def state(a: float, b: float, slopes: bool) -> Look:
        if not slopes:
            return _look(np.linalg.eigvals(_balanced(family(a, b).collocated(order))[0]))
        return _look_around(family, order, (a, b), (x, y))

    def crossing(one: Array, other: Array, unstable: Look) -> tuple[float, complex] | None:
        return _exact_crossing(family, one, other, unstable.root)

    # With many small matrices, threads of BLAS wait for one another.
    with threadpool_limits(1):
        return replace(_charted(state, crossing, x, y, points), evaluations=family.made)


def config_chart(
    config: str | Path | Mapping[str, Any],
    x: ParameterRange,
    y: ParameterRange,
    overrides: Iterable[str] = (),
    *,
    at_time: float | None = None,
    trimmed: Sequence[str] | None = None,
    points: int | None = None,
) -> Chart:
    """Stability of a config over two of its values, `run.step_size` among them.

    Args:
        config, overrides: as `orchestrator.simulation.run.prepare`.
        at_time: see `linearise` [s].
        trimmed: linear around the steady state of each pair, these states fixed; None: it is not.
        points: along either axis; None: 200, and 50 with the communication step.
    Raises: ConfigError for a value that the config does not take, and as `chart_of`.
    """
    overrides = tuple(overrides)
    if x.path == y.path:
        what = f"both ranges are of {x.path}"
        raise ConfigError([Problem("--over", what, "two different parameters are needed")])
    spans = (x.low, x.high), (y.low, y.high)

    def prepared(*pairs: tuple[ParameterRange, float]) -> Prepared:
        made = prepare(config, (*overrides, *(one.override(value) for one, value in pairs)))
        return made if trimmed is None else trim(made, trimmed).prepared

    if STEP in (x.path, y.path):
        found = _sampled_chart(prepared, x, y, at_time, points or 50)
    else:
        found = chart_of(
            lambda a, b: linearise(prepared((x, a), (y, b)), at_time=at_time).system, *spans, points or 200
        )
    at, beside = (_here(prepare(config, overrides), one) for one in (x, y))
    here = None if at is None or beside is None else (at, beside)
    return replace(found, x_name=x.path, y_name=y.path, x_unit=x.unit, y_unit=y.unit, here=here)


def _here(prepared: Prepared, one: ParameterRange) -> float | None:
    """The value that a config has, in the unit of a range; None if it is no start value and not the step."""
    value: Value | None
    if one.path == STEP:
        value, unit = float(prepared.grid.step_size), "s"
    else:
        name, _, variable = one.path.partition(".")
        instance = next((each for each in prepared.system.instances if each.name == name), None)
        if instance is None or variable not in instance.fmu.description.variables:
            return None
        declared = instance.variable(variable)
        value = instance.start[variable] if variable in instance.start else declared.start
        unit = declared.unit_name or ""
        if not isinstance(value, int | float):
            return None
    if one.unit in ("", unit):
        return float(value)
    none, unity = (
        quantity("", Measure(unit, parse_unit(unit)), f"{factor!r} {one.unit}", one.path)
        for factor in (0.0, 1.0)
    )
    if isinstance(none, Problem) or isinstance(unity, Problem):
        return None
    return (float(value) - none) / (unity - none)


def _look(roots: NDArray[np.inexact[Any]], slopes: Array | None = None) -> Look:
    """How many of all roots grow, and the rightmost."""
    size = float(abs(roots).max(initial=0.0))
    # Integrators' roots are 0 to rounding.
    moving = np.flatnonzero(abs(roots) > 1e-9 * size)
    if not moving.size:
        return Look(0, 0j, np.zeros(0))
    ordered = moving[np.argsort(-roots[moving].real)]
    first, chosen = roots[ordered[0]], ordered[:_WATCHED]
    growing = int(np.sum(roots[moving].real > 1e-10 * abs(roots[moving])))
    return Look(
        growing,
        complex(first.real, abs(first.imag)),
        np.asarray(roots[chosen].real, np.float64),
        None if slopes is None else slopes[chosen],
    )


def _balanced(matrix: Array) -> tuple[Array, Array, NDArray[np.intp]]:
    balanced, (scale, order) = scipy.linalg.matrix_balance(matrix, separate=True)
    return balanced, scale, order


def _look_around(
    family: Family,
    order: int,
    point: tuple[float, float],
    spans: Sequence[tuple[float, float]],
) -> Look:
    """A look with slopes: of an eigenvalue it is w M' v, with v and w its right and left vector."""
    matrix = family(*point).collocated(order)
    changes = []
    for axis, (low, high) in enumerate(spans):
        step = _APART * (high - low) * (1.0 if point[axis] < 0.5 * (low + high) else -1.0)
        beside = list(point)
        beside[axis] += step
        other = family(*beside).collocated(order)
        if other.shape != matrix.shape:  # a delay begins here
            return _look(np.linalg.eigvals(_balanced(matrix)[0]))
        changes.append((other - matrix) * ((high - low) / step))
    balanced, scale, permuted = _balanced(matrix)
    roots, right = np.linalg.eig(balanced)
    left = np.linalg.inv(right)
    moved = [change[np.ix_(permuted, permuted)] * scale / scale[:, None] for change in changes]
    slopes = [np.sum((left @ one) * right.T, axis=1).real for one in moved]
    return _look(roots, np.stack(slopes, axis=1))


def _trusted_order(family: Family, x: tuple[float, float], y: tuple[float, float]) -> int:
    """The least order that counts as the highest one does at points all over the chart, and as the argument
    principle at some of them.
    """
    draw = np.random.default_rng(1)
    systems = [family(float(draw.uniform(*x)), float(draw.uniform(*y))) for _ in range(_COMPARED)]
    counts = [_look(system.guesses(_ORDERS[-1])).unstable for system in systems]
    for index, system in enumerate(systems[:_CHECKED]):
        try:
            counts[index] = system.count_right_of(0.0)
        except OrchestratorError:  # it stands on the border, or a root at 0 does
            continue
    for order in _ORDERS:
        if all(
            _look(system.guesses(order)).unstable == count
            for system, count in zip(systems, counts, strict=True)
        ):
            return order
    raise OrchestratorError("--over: the roots could not be counted reliably; take smaller ranges")


def _exact_crossing(
    family: Family, stable: Array, unstable: Array, guess: complex
) -> tuple[float, complex] | None:
    """Where between two points a root crosses: share of the way, and the root; None: not found."""
    ends = np.array([stable, unstable])

    def root(share: float, near: complex) -> complex | None:
        return family(*(ends[0] + share * (ends[1] - ends[0]))).root_near(near)

    high = root(1.0, guess)
    low = None if high is None else root(0.0, high)
    if high is None or low is None:
        return None
    at_zero = 1e-9 * abs(high)
    for share, one in ((0.0, low), (1.0, high)):
        if abs(one.real) <= at_zero:
            return share, one
    if not low.real < 0.0 < high.real:
        return None
    # The Illinois method: an end that stays counts half.
    begin, end, below, above = 0.0, 1.0, low.real, high.real
    share, middle = 0.5, low
    for _ in range(30):
        share = begin + (end - begin) * below / (below - above)
        found = root(share, low + (high - low) * (share - begin) / (end - begin))
        if found is None:
            return None
        same, middle = (found.real > 0.0) == (middle.real > 0.0), found
        if abs(middle.real) < at_zero or end - begin < 1e-6:
            break
        if middle.real > 0.0:
            end, high, above, below = share, middle, middle.real, 0.5 * below if same else below
        else:
            begin, low, below, above = share, middle, middle.real, 0.5 * above if same else above
    return share, middle


class _Grid:
    """Points of a chart, looked at where they are needed."""

    def __init__(
        self, state: State, x_span: tuple[float, float], y_span: tuple[float, float], points: int
    ) -> None:
        self.state = state
        levels = max(0, int(np.ceil(np.log2(points / _CELLS))))
        self.coarse = 2**levels
        self.side = max(2, round(points / self.coarse)) * self.coarse
        self.x, self.y = np.linspace(*x_span, self.side + 1), np.linspace(*y_span, self.side + 1)
        self._known: dict[tuple[int, int], tuple[Look, bool]] = {}

    def look(self, i: int, j: int, slopes: bool = False) -> Look:
        """What is known at a point; with slopes where there are any."""
        if (i, j) not in self._known or slopes > self._known[i, j][1]:
            self._known[i, j] = self.state(float(self.x[i]), float(self.y[j]), slopes), slopes
        return self._known[i, j][0]

    def stable(self, i: int, j: int) -> bool:
        return self.look(i, j).unstable == 0

    def mixed(self) -> list[tuple[int, int]]:
        """The finest cells that the border passes, by their lower corner."""
        size = self.coarse
        whole = range(0, self.side, size)
        cells = [(i, j) for i in whole for j in whole]
        while size > 1:
            first = size == self.coarse
            looks = {cell: [self.look(*one, first) for one in _ring(*cell, size)] for cell in cells}
            found = [cell for cell in cells if len({one.unstable > 0 for one in looks[cell]}) > 1]
            # A border may cut a corner of a neighbour that all corners of it do not show.
            wide = {(i + a * size, j + b * size) for i, j in found for a in (-1, 0, 1) for b in (-1, 0, 1)}
            wide |= {cell for cell in cells if cell not in wide and self._may_change(cell, size)}
            size //= 2
            cells = [
                (i + a, j + b)
                for i, j in sorted(wide)
                if 0 <= i < self.side and 0 <= j < self.side
                for a in (0, size)
                for b in (0, size)
            ]
        return [cell for cell in cells if len({self.stable(*corner) for corner in _ring(*cell, 1)}) > 1]

    def _may_change(self, cell: tuple[int, int], size: int) -> bool:
        """Whether stability may change within a cell whose corners agree."""
        corners = [self.look(*one, slopes=True) for one in _ring(*cell, size)]
        stable = corners[0].unstable == 0
        slopes = [one.slopes for one in corners if one.slopes is not None]
        if len(slopes) < len(corners):
            levels = [one.root.real for one in corners]
            reach = 0.5 * (max(levels) - min(levels))
            return max(levels) + reach > 0.0 if stable else min(levels) - reach < 0.0
        for one, slope in zip(corners, slopes, strict=True):
            reach = _AHEAD * size / self.side * np.sum(abs(slope), axis=1)
            if np.any(one.levels + reach > 0.0) if stable else not np.any(one.levels - reach > 0.0):
                return True
        return False

    def values(self) -> tuple[NDArray[np.int64], Complex]:
        """Counts and dominant roots everywhere, shape (ny, nx)."""
        counts = np.full((self.side + 1, self.side + 1), -1)
        roots = np.zeros(counts.shape, np.complex128)
        for (i, j), (one, _) in self._known.items():
            counts[j, i], roots[j, i] = one.unstable, one.root
        _fill(counts, roots, self.coarse)
        return counts, roots


def _ring(i: int, j: int, size: int) -> list[tuple[int, int]]:
    return [(i, j), (i + size, j), (i + size, j + size), (i, j + size)]


def _charted(
    state: State,
    crossing: Callable[[Array, Array, Look], tuple[float, complex] | None],
    x_span: tuple[float, float],
    y_span: tuple[float, float],
    points: int,
) -> Chart:
    grid = _Grid(state, x_span, y_span, points)
    segments = []
    known: dict[tuple[int, int, int, int], tuple[float, float, float]] = {}
    for cell in grid.mixed():
        ring = _ring(*cell, 1)
        ends = []
        for one, other in zip(ring, ring[1:] + ring[:1], strict=True):
            if grid.stable(*one) == grid.stable(*other):
                continue
            stable, unstable = (one, other) if grid.stable(*one) else (other, one)
            key = (*stable, *unstable)
            if key not in known:
                begin, end = (np.array([grid.x[a], grid.y[b]]) for a, b in (stable, unstable))
                share, root = crossing(begin, end, grid.look(*unstable)) or _bisected(state, begin, end)
                known[key] = (*(begin + share * (end - begin)).tolist(), abs(root.imag) / (2.0 * np.pi))
            ends.append(key)
        segments += [(ends[k], ends[k + 1]) for k in range(0, len(ends) - 1, 2)]
    counts, roots = grid.values()
    lines = tuple(np.array([known[one] for one in line]) for line in _chained(segments))
    return Chart("x", "y", "", "", grid.x, grid.y, counts, roots, lines)


def _bisected(state: State, begin: Array, end: Array) -> tuple[float, complex]:
    """Where between two points stability ends, by halving; and the root there."""
    low, high, root = 0.0, 1.0, 0j
    while high - low > 0.1:
        middle = 0.5 * (low + high)
        x, y = begin + middle * (end - begin)
        found = state(float(x), float(y), False)
        low, high = (low, middle) if found.unstable else (middle, high)
        root = found.root if found.unstable or not root else root
    return 0.5 * (low + high), root


def _fill(counts: NDArray[np.int64], roots: Complex, coarse: int) -> None:
    """Points that were not looked at take the count of their cell, and a root between its corners'."""
    places = np.arange(0, len(counts), coarse)
    inner = np.arange(len(counts))
    low = np.minimum(inner // coarse, len(places) - 2)
    share = inner / coarse - low
    grid = roots[np.ix_(places, places)]
    rows = grid[low] * (1.0 - share)[:, None] + grid[low + 1] * share[:, None]
    made = rows[:, low] * (1.0 - share) + rows[:, low + 1] * share
    nearest = counts[np.ix_(places[low + (share > 0.5)], places[low + (share > 0.5)])]
    unseen = counts < 0
    counts[unseen], roots[unseen] = nearest[unseen], made[unseen]


def _chained(segments: Sequence[tuple[Any, Any]]) -> list[list[Any]]:
    """Lines from segments that share ends."""
    after: dict[Any, list[Any]] = {}
    for one, other in segments:
        after.setdefault(one, []).append(other)
        after.setdefault(other, []).append(one)
    lines = []
    while after:
        begin = next((one for one, others in after.items() if len(others) == 1), next(iter(after)))
        line = [begin]
        while after.get(line[-1]):
            here = line[-1]
            following = after[here].pop()
            after[following].remove(here)
            line.append(following)
        for one in line:
            if not after.get(one):
                after.pop(one, None)
        lines.append(line)
    return lines


def _sampled_chart(
    prepared: Callable[..., Prepared],
    x: ParameterRange,
    y: ParameterRange,
    at_time: float | None,
    points: int,
) -> Chart:
    """Stability of the co-simulation over its step and another parameter."""
    other = y if x.path == STEP else x
    steps = x if x.path == STEP else y
    known: dict[float, tuple[Prepared, Linearised, int]] = {}
    looked = 0

    def state(a: float, b: float, slopes: bool) -> Look:
        nonlocal looked
        step, value = (a, b) if x.path == STEP else (b, a)
        if value not in known:
            made = prepared((other, value))
            linear = linearise(made, at_time=at_time)
            known[value] = made, linear, resting_roots(linear.modes())
        made, linear, resting = known[value]
        size = quantity("", Measure("s", parse_unit("s")), f"{step!r} {steps.unit}".rstrip(), STEP)
        if isinstance(size, Problem):
            raise ConfigError([size])
        looked += 1
        sampled = sampled_system(with_step(made, size), linear, resting)
        modes = sampled.modes(1)
        root = modes[0].root if modes else 0j
        return Look(sampled.unstable, root, np.array([root.real]))

    def crossing(one: Array, two: Array, unstable: Look) -> None:
        return None

    with threadpool_limits(1):
        found = _charted(state, crossing, (x.low, x.high), (y.low, y.high), points)
    return replace(found, sampled=True, evaluations=looked)
