"""Where a system is stable over two of its parameters, and the border between.

The system is linearised at a few Chebyshev points and its matrices are interpolated between them, to 1e-5 of
their size. Roots are counted on a coarse grid, and finer only in cells that the border passes. On the sides
of the finest cells the border is where the exact root of the equation has the real part 0. With the
communication step as a parameter the eigenvalues of the sampled system are counted, and the border is found
by bisection.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from ..base.errors import ConfigError, OrchestratorError, Problem
from ..base.quantities import Measure, quantity
from ..base.units import parse_unit
from ..simulation.run import Prepared, prepare
from .delay_system import DelaySystem, Link
from .from_system import Linearised, linearise
from .over_parameter import STEP, ParameterRange
from .sampled_system import sampled_system
from .step_report import resting_roots, with_step
from .trim import trim

__all__ = ["Chart", "chart_data", "chart_figure", "chart_of", "chart_text", "config_chart"]

Array = NDArray[np.float64]

# Points of the interpolation along either axis, and how far it may be off, relative to the largest value.
_NODES = (2, 3, 5, 9, 16)
_INTERPOLATED = 1e-5
# Points of a delay in the discretisation that counts roots, and how many counts are checked by the argument
# principle.
_ORDERS = (10, 16, 28, 48)
_CHECKED = 24
# Cells of the first grid along either axis; each is divided in two until the grid is fine.
_CELLS = 25
_BORDER = 1e-3


@dataclass(frozen=True)
class Chart:
    """Stability over two parameters.

    Attributes:
        x_name, y_name, x_unit, y_unit: of the axes.
        x, y: shapes (nx,), (ny,).
        unstable: number of roots that grow, shape (ny, nx).
        root: dominant root, exact to some digits, shape (ny, nx) [rad/s]; between points of the coarse grid,
            away
            from the border, interpolated.
        border: lines between stable and unstable, each of shape (k, 3): x, y, frequency there [Hz].
        sampled: whether it is the co-simulation with its step, or the machine.
        here: x and y of the config; None if not known.
        evaluations: how many systems were linearised or sampled.
    """

    x_name: str
    y_name: str
    x_unit: str
    y_unit: str
    x: Array
    y: Array
    unstable: NDArray[np.int64]
    root: NDArray[np.complex128]
    border: tuple[Array, ...]
    sampled: bool = False
    here: tuple[float, float] | None = None
    evaluations: int = 0

    @property
    def stable(self) -> NDArray[np.bool_]:
        """Where no root grows, shape (ny, nx)."""
        return self.unstable == 0


State = tuple[int, complex]


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
        cannot be
        counted.
    """
    family = _Family(make, (x, y))
    order = _trusted_order(family, x, y)

    def state(a: float, b: float) -> State:
        return _state(family(a, b), order)

    def crossing(one: tuple[float, float], other: tuple[float, float], stable: State, unstable: State) -> Any:
        return _exact_crossing(family, one, other, unstable[1])

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
    here = tuple(_here(prepare(config, overrides), one) for one in (x, y))
    known = None if None in here else here
    return replace(found, x_name=x.path, y_name=y.path, x_unit=x.unit, y_unit=y.unit, here=known)


def _here(prepared: Prepared, one: ParameterRange) -> float | None:
    """The value that a config has, in the unit of a range; None if it is no start value and not the step."""
    if one.path == STEP:
        value, unit = float(prepared.grid.step_size), "s"
    else:
        name, _, variable = one.path.partition(".")
        instance = next((each for each in prepared.system.instances if each.name == name), None)
        if instance is None or variable not in instance.fmu.description.variables:
            return None
        declared = instance.variable(variable)
        value = instance.start.get(variable, declared.start)
        unit = declared.unit_name or ""
        if not isinstance(value, int | float):
            return None
    if one.unit in ("", unit):
        return float(value)
    scale = [
        quantity("", Measure(unit, parse_unit(unit)), f"{factor!r} {one.unit}", one.path)
        for factor in (0.0, 1.0)
    ]
    if any(isinstance(each, Problem) for each in scale):
        return None
    return (float(value) - scale[0]) / (scale[1] - scale[0])


class _Family:
    """Systems of two values, interpolated between a few."""

    def __init__(
        self, make: Callable[[float, float], DelaySystem], spans: Sequence[tuple[float, float]]
    ) -> None:
        self.make, self.made = make, 0
        self._known: dict[tuple[float, float], DelaySystem] = {}
        self.logs, self.spans, counts = [False, False], list(spans), [2, 2]
        # Each axis takes as many points as a line along it needs, over the value or its logarithm.
        for axis, span in enumerate(spans):
            choices = [(count, log) for count in _NODES for log in (False, True) if not log or span[0] > 0.0]
            for count, log in choices:
                self.logs[axis], self.spans[axis] = log, self._inner(span, log)
                counts[axis] = count
                if self._fits(axis, count):
                    break
            else:
                what = "the linear system does not depend smoothly on the parameters"
                raise ConfigError([Problem("--over", what, "", "Take smaller ranges, or one parameter.")])
        self.nodes = [_nodes(count) for count in counts]
        places = [[self._outer(place, axis) for place in self.nodes[axis]] for axis in (0, 1)]
        values = np.array([[self._values(a, b) for b in places[1]] for a in places[0]])
        self.weights = [_weights(count) for count in counts]
        # What is the same everywhere stays so to the last bit.
        self.varies = np.flatnonzero(np.ptp(values.reshape(-1, values.shape[-1]), axis=0) > 0.0)
        self.fixed, self.values = values[0, 0], values[:, :, self.varies]
        middle = [self._outer(0.123, 0), self._outer(-0.37, 1)]
        self._check(self._interpolated(*middle), self._values(*middle), "between its points")

    @staticmethod
    def _inner(span: tuple[float, float], log: bool) -> tuple[float, float]:
        return (np.log(span[0]), np.log(span[1])) if log else span

    def _outer(self, place: float, axis: int) -> float:
        """From [-1, 1] to a value."""
        low, high = self.spans[axis]
        value = low + 0.5 * (place + 1.0) * (high - low)
        return float(np.exp(value)) if self.logs[axis] else float(value)

    def _place(self, value: float, axis: int) -> float:
        low, high = self.spans[axis]
        return 2.0 * ((np.log(value) if self.logs[axis] else value) - low) / (high - low) - 1.0

    def _values(self, a: float, b: float) -> Array:
        if (a, b) not in self._known:
            self._known[a, b] = self.make(a, b)
            self.made += 1
        one = self._known[a, b]
        links = np.array([(link.gain, link.delay) for link in one.links]).reshape(-1, 2)
        if not hasattr(self, "system"):
            self.system = one
        same = self.system
        shape = (one.states, one.inputs, one.outputs, [link[:3] for link in one.links])
        if shape != (same.states, same.inputs, same.outputs, [link[:3] for link in same.links]):
            what = (
                "the parameters change what the linear system consists of: a delay or a filter comes or goes"
            )
            raise ConfigError(
                [Problem("--over", what, "", "Take ranges within which nothing comes or goes.")]
            )
        return np.concatenate([one.a.ravel(), one.b.ravel(), one.c.ravel(), one.d.ravel(), links.ravel()])

    def _fits(self, axis: int, count: int) -> bool:
        """Whether so many points along an axis, through the middle of the other, give what lies between."""
        other = self._outer(0.0, 1 - axis)

        def at(place: float) -> Array:
            value = self._outer(place, axis)
            return self._values(value, other) if axis == 0 else self._values(other, value)

        nodes = _nodes(count)
        values = np.array([at(place) for place in nodes])
        size = self._size(values)
        for place in (-0.83, 0.31):
            made = _share(place, nodes, _weights(count)) @ values
            if np.max(abs(made - at(place)) - _INTERPOLATED * size) > 0.0:
                return False
        return True

    def _size(self, values: Array) -> Array:
        """What errors are judged by: each number's size, or a share of its matrix's largest."""
        size = np.max(abs(values), axis=0)
        edges = np.cumsum(
            [matrix.size for matrix in (self.system.a, self.system.b, self.system.c, self.system.d)]
        )
        least = [np.full(len(part), 1e-4 * np.max(part, initial=0.0)) for part in np.split(size, edges)]
        return np.maximum(size, np.concatenate(least))

    def _check(self, made: Array, wanted: Array, where: str) -> None:
        if np.max(abs(made - wanted) - 10.0 * _INTERPOLATED * self._size(np.array([made, wanted]))) > 0.0:
            what = f"the linear system does not depend smoothly on the parameters {where}"
            raise ConfigError([Problem("--over", what, "", "Take smaller ranges.")])

    def _interpolated(self, a: float, b: float) -> Array:
        along = [
            _share(self._place(value, axis), self.nodes[axis], self.weights[axis])
            for axis, value in enumerate((a, b))
        ]
        values = self.fixed.copy()
        values[self.varies] = np.einsum("i,j,ijk->k", *along, self.values)
        return values

    def __call__(self, a: float, b: float) -> DelaySystem:
        """The system of two values."""
        values, one, low = self._interpolated(a, b), self.system, 0
        made = []
        for matrix in (one.a, one.b, one.c, one.d):
            made.append(values[low : low + matrix.size].reshape(matrix.shape))
            low += matrix.size
        rest = values[low:].reshape(-1, 2)
        links = tuple(
            Link(*link[:3], float(gain), max(float(delay), 0.0))
            for link, (gain, delay) in zip(one.links, rest, strict=True)
        )
        return replace(one, a=made[0], b=made[1], c=made[2], d=made[3], links=links)


def _nodes(count: int) -> Array:
    return np.cos(np.pi * (np.arange(count) + 0.5) / count)


def _weights(count: int) -> Array:
    return (-1.0) ** np.arange(count) * np.sin(np.pi * (np.arange(count) + 0.5) / count)


def _share(place: float, nodes: Array, weights: Array) -> Array:
    """Shares of the points in the interpolated value: the barycentric formula."""
    apart = place - nodes
    near = int(np.argmin(abs(apart)))
    if abs(apart[near]) < 1e-14:
        return np.eye(len(nodes))[near]
    share = weights / apart
    return share / share.sum()


def _state(system: DelaySystem, order: int) -> State:
    """How many roots grow, and the dominant one that is not 0."""
    roots = system.guesses(order)
    size = np.max(abs(roots), initial=0.0)
    # Integrators' roots are 0 to rounding.
    moving = roots[abs(roots) > 1e-9 * size]
    if not moving.size:
        return 0, 0j
    first = moving[np.argmax(moving.real)]
    growing = int(np.sum(moving.real > 1e-10 * abs(moving)))
    return growing, complex(first.real, abs(first.imag))


def _trusted_order(family: _Family, x: tuple[float, float], y: tuple[float, float]) -> int:
    """The least order that counts as the argument principle does, at some points all over the chart."""
    draw = np.random.default_rng(1)
    places = [(float(draw.uniform(*x)), float(draw.uniform(*y))) for _ in range(_CHECKED)]
    exact = []
    for place in places:
        system = family(*place)
        try:
            exact.append((system, system.count_right_of(0.0)))
        except OrchestratorError:  # it stands on the border, or a root at 0 does
            continue
    for order in _ORDERS:
        if all(_state(system, order)[0] == count for system, count in exact):
            return order
    raise OrchestratorError("--over: the roots could not be counted reliably; take smaller ranges")


def _exact_crossing(
    family: _Family, stable: tuple[float, float], unstable: tuple[float, float], guess: complex
) -> tuple[float, complex] | None:
    """Where between two points a root crosses: share of the way, and the root; None: not found."""
    ends = np.array([stable, unstable])

    def root(share: float, near: complex) -> complex | None:
        return family(*(ends[0] + share * (ends[1] - ends[0]))).root_near(near)

    high = root(1.0, guess)
    low = None if high is None else root(0.0, high)
    if high is None or low is None or not low.real <= 0.0 <= high.real:
        return None
    begin, end, share = 0.0, 1.0, 0.5
    for _ in range(30):
        share = begin + (end - begin) * (-low.real / (high.real - low.real)) if high.real > low.real else 0.5
        share = min(max(share, begin + 0.02 * (end - begin)), end - 0.02 * (end - begin))
        middle = root(share, low + (high - low) * (share - begin) / (end - begin))
        if middle is None:
            return None
        if abs(middle.real) < 1e-9 * abs(middle) or end - begin < 1e-6:
            return share, middle
        if middle.real > 0.0:
            end, high = share, middle
        else:
            begin, low = share, middle
    return share, middle


def _charted(
    state: Callable[[float, float], State],
    crossing: Callable[..., tuple[float, complex] | None],
    x_span: tuple[float, float],
    y_span: tuple[float, float],
    points: int,
) -> Chart:
    levels = max(0, int(np.ceil(np.log2(points / _CELLS))))
    side = max(2, round(points / 2**levels)) * 2**levels
    across, up = np.linspace(*x_span, side + 1), np.linspace(*y_span, side + 1)
    counts = np.full((side + 1, side + 1), -1)
    roots = np.zeros(counts.shape, np.complex128)

    def look(i: int, j: int) -> int:
        if counts[j, i] < 0:
            counts[j, i], roots[j, i] = state(float(across[i]), float(up[j]))
        return int(counts[j, i])

    def corners(i: int, j: int, size: int) -> list[int]:
        return [look(i + a, j + b) for a, b in ((0, 0), (size, 0), (size, size), (0, size))]

    size = 2**levels
    coarse = size
    whole = range(0, side, size)
    cells = [(i, j) for i in whole for j in whole]
    while True:
        mixed = [(i, j) for i, j in cells if len({one > 0 for one in corners(i, j, size)}) > 1]
        if size == 1:
            break
        # A border may cut a corner of a neighbour that all corners of it do not show.
        wide = {(i + a * size, j + b * size) for i, j in mixed for a in (-1, 0, 1) for b in (-1, 0, 1)}
        half = size // 2
        cells = [
            (i + a, j + b)
            for i, j in sorted(wide)
            if 0 <= i < side and 0 <= j < side
            for a in (0, half)
            for b in (0, half)
        ]
        size = half
    segments = []
    known: dict[tuple[int, int, int, int], tuple[float, float, float]] = {}
    for i, j in mixed:
        ring = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
        ends = []
        for one, other in zip(ring, ring[1:] + ring[:1], strict=True):
            if (counts[one[::-1]] > 0) == (counts[other[::-1]] > 0):
                continue
            stable, unstable = (one, other) if counts[one[::-1]] == 0 else (other, one)
            key = (*stable, *unstable)
            if key not in known:
                begin, end = (np.array([across[a], up[b]]) for a, b in (stable, unstable))
                found = crossing(
                    tuple(begin),
                    tuple(end),
                    *((int(counts[p[::-1]]), complex(roots[p[::-1]])) for p in (stable, unstable)),
                )
                share, root = found or _bisected(state, begin, end)
                known[key] = (*(begin + share * (end - begin)).tolist(), abs(root.imag) / (2.0 * np.pi))
            ends.append(known[key])
        segments += [(ends[k], ends[k + 1]) for k in range(0, len(ends) - 1, 2)]
    _fill(counts, roots, coarse)
    return Chart("x", "y", "", "", across, up, counts, roots, tuple(_chained(segments)))


def _bisected(state: Callable[[float, float], State], begin: Array, end: Array) -> tuple[float, complex]:
    """Where between two points stability ends, by halving; and the root there."""
    low, high, root = 0.0, 1.0, 0j
    while high - low > 0.1:
        middle = 0.5 * (low + high)
        count, found = state(*(begin + middle * (end - begin)).tolist())
        low, high = (low, middle) if count else (middle, high)
        root = found if count or not root else root
    return 0.5 * (low + high), root


def _fill(counts: NDArray[np.int64], roots: NDArray[np.complex128], coarse: int) -> None:
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


def _chained(segments: Sequence[tuple[Any, Any]]) -> list[Array]:
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
        lines.append(np.array(line))
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

    def state(a: float, b: float) -> State:
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
        return sampled.unstable, modes[0].root if modes else 0j

    def crossing(one: Any, two: Any, stable: State, unstable: State) -> None:
        return None

    with threadpool_limits(1):
        found = _charted(state, crossing, (x.low, x.high), (y.low, y.high), points)
    return replace(found, sampled=True, evaluations=looked)


def chart_text(found: Chart) -> str:
    """The chart in lines for terminals."""
    what = "co-simulation" if found.sampled else "machine"
    share = 100.0 * float(np.mean(found.stable))
    lines = [f"{what} over {found.x_name} and {found.y_name}: stable in {share:.3g} % of the chart"]
    for line in found.border:
        (x0, y0), (x1, y1) = line[0, :2], line[-1, :2]
        lines.append(
            f"  border from {x0:.5g} {found.x_unit}, {y0:.5g} {found.y_unit} to {x1:.5g} {found.x_unit}, "
            f"{y1:.5g} {found.y_unit}; {line[:, 2].min():.4g} to {line[:, 2].max():.4g} Hz"
        )
    return "\n".join(lines)


def chart_data(found: Chart) -> dict[str, Any]:
    """The chart for JSON: axes, counts, dominant root's real part and frequency, border lines."""
    return {
        "x": {"parameter": found.x_name, "unit": found.x_unit, "values": found.x.tolist()},
        "y": {"parameter": found.y_name, "unit": found.y_unit, "values": found.y.tolist()},
        "sampled": found.sampled,
        "unstable": found.unstable.tolist(),
        "border": [line.tolist() for line in found.border],
        "config": found.here,
        "evaluations": found.evaluations,
    }


def chart_figure(
    found: Chart,
    field: Array | None = None,
    label: str = "real part of the dominant root [1/s]",
    points: Mapping[str, tuple[float, float]] | None = None,
) -> Any:
    """The dominant root's real part as colours, the border, and the config.

    Args:
        field: other values as colours, 0 on the border, shape (ny, nx); label: of their scale.
        points: further points, x and y by name.
    """
    from matplotlib.figure import Figure

    from ..plotting.figures import COLORS

    figure = Figure(figsize=(7.5, 5.0), layout="constrained")
    axes = figure.subplots()
    values = found.root.real if field is None else field
    limit = float(np.nanpercentile(abs(values), 95)) or 1.0
    mesh = axes.pcolormesh(
        found.x, found.y, values, cmap="RdBu_r", vmin=-limit, vmax=limit, shading="nearest", rasterized=True
    )
    figure.colorbar(mesh, ax=axes, label=label, extend="both")
    for index, line in enumerate(found.border):
        axes.plot(
            line[:, 0],
            line[:, 1],
            color="black",
            linewidth=2.0,
            label=None if index else "border of stability",
        )
    marks = ({"this config": found.here} if found.here else {}) | dict(points or {})
    for index, (name, (px, py)) in enumerate(marks.items()):
        if found.x[0] <= px <= found.x[-1] and found.y[0] <= py <= found.y[-1]:
            axes.plot(
                [px],
                [py],
                "osvD^"[index % 5],
                color="black",
                markerfacecolor=COLORS[(index + 1) % len(COLORS)],
                markersize=8,
                label=name,
                linestyle="",
                clip_on=False,
                zorder=5,
            )
    axes.set_xlabel(f"{found.x_name} [{found.x_unit or '1'}]")
    axes.set_ylabel(f"{found.y_name} [{found.y_unit or '1'}]")
    axes.set_title("co-simulation with its step" if found.sampled else "machine", fontsize="medium")
    if axes.get_legend_handles_labels()[0]:
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure
