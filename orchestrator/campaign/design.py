"""Designs: blocks of points that are known by their number, so that none is kept before it is run."""

from __future__ import annotations

import math
import warnings
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from itertools import accumulate
from typing import Protocol

import numpy as np

from ..base.errors import Problem, listed
from ..config import path_text
from .axes import Axis, Level
from .models import BlockModel, DrawnModel, RangeModel, RepeatsModel, SampleModel

Point = dict[str, Level]
Path = tuple[str | int, ...]
# Seeds that any tool takes: positive and of 31 bits.
_SEEDS = 2**31 - 1


class Block(Protocol):
    """Points by their number."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int) -> Point:
        """The values of a point, by path."""


class _Listed:
    def __init__(self, points: Sequence[Point]) -> None:
        self._points = points

    def __len__(self) -> int:
        return len(self._points)

    def __getitem__(self, index: int) -> Point:
        return dict(self._points[index])


class _Product:
    """Every point of each block with every one of the others; the last block varies fastest."""

    def __init__(self, blocks: Sequence[Block]) -> None:
        self._blocks = blocks

    def __len__(self) -> int:
        return math.prod(len(one) for one in self._blocks)

    def __getitem__(self, index: int) -> Point:
        point: Point = {}
        for block in reversed(self._blocks):
            index, inner = divmod(index, len(block))
            point = block[inner] | point
        return point


class Sum:
    """The points of one block after those of another."""

    def __init__(self, blocks: Sequence[Block]) -> None:
        self._blocks = blocks
        self._ends = list(accumulate(len(one) for one in blocks))

    def __len__(self) -> int:
        return self._ends[-1] if self._ends else 0

    def __getitem__(self, index: int) -> Point:
        number = bisect_right(self._ends, index)
        return self._blocks[number][index - (self._ends[number - 1] if number else 0)]


class _Drawn:
    """Points drawn in the unit cube, shape (count, axes), and what each of their numbers stands for."""

    def __init__(self, cube: np.ndarray, values: Mapping[str, _Distribution]) -> None:
        self._cube, self._values = cube, values

    def __len__(self) -> int:
        return len(self._cube)

    def __getitem__(self, index: int) -> Point:
        row = self._cube[index].tolist()
        return {path: one.at(u) for (path, one), u in zip(self._values.items(), row, strict=True)}


class _Distribution:
    """Turns a number from 0 to 1 into a value."""

    def __init__(self, axis: Axis, model: DrawnModel, place: str, problems: list[Problem]) -> None:
        self._axis, self._model = axis, model
        self.ends: list[Level] = []
        self._numbers: list[float] = []
        self._whole = False
        found = len(problems)
        if model.choice is not None:
            self.ends = _levels(axis, model.choice, place, problems)
            return
        normal = model.normal
        written = model.uniform or model.log_uniform or []
        if normal is not None:
            written = [one for one in (normal.mean, normal.low, normal.high) if one is not None]
        levels = _levels(axis, written, place, problems)
        # After the mean: for an option, the first value with a unit gives the unit of the axis.
        deviation = None if normal is None else axis.spread(normal.std, place)
        if isinstance(deviation, Problem):
            problems.append(deviation)
        if len(problems) > found:
            return
        for level in levels:
            if isinstance(level.shown, bool) or not isinstance(level.shown, int | float):
                problems.append(Problem(place, f"{axis.path} cannot be drawn: {level.shown!r} is no number"))
                return
            self._numbers.append(float(level.shown))
        self.ends = levels
        self._whole = axis.whole(levels)
        if normal is None:
            low, high = self._numbers
            if not low < high:
                problems.append(Problem(place, f"{axis.path}: {written[0]!r} is not below {written[1]!r}"))
            elif model.log_uniform is not None and low <= 0.0:
                problems.append(Problem(place, f"{axis.path}: {written[0]!r} has no logarithm"))
            return
        assert isinstance(deviation, float)
        self._deviation = deviation
        self._low = -math.inf if normal.low is None else self._numbers[1]
        self._high = math.inf if normal.high is None else self._numbers[-1]
        if deviation <= 0.0:
            problems.append(Problem(place, f"{axis.path}: std {normal.std!r} is not positive"))
        elif not self._low < self._high:
            problems.append(Problem(place, f"{axis.path}: low is not below high"))

    def at(self, u: float) -> Level:
        model = self._model
        if model.choice is not None:
            return self.ends[min(int(u * len(self.ends)), len(self.ends) - 1)]
        # Whole numbers stand for all that is rounded to them: the ends as often as those between.
        beyond = 0.5 if self._whole else 0.0
        if model.normal is not None:
            from scipy.special import ndtr, ndtri

            mean, deviation = self._numbers[0], self._deviation
            low, high = self._low, self._high
            below, above = (float(ndtr((one - mean) / deviation)) for one in (low - beyond, high + beyond))
            u = min(max(below + u * (above - below), 2.0**-53), 1.0 - 2.0**-53)
            number = mean + deviation * float(ndtri(u))
        else:
            low, high = self._numbers
            begin, end = low - beyond, high + beyond
            number = (
                begin * (end / begin) ** u if model.log_uniform is not None else begin + u * (end - begin)
            )
        return self._axis.at(min(max(number, low), high), self._whole)


def _levels(axis: Axis, values: Sequence[object], place: str, problems: list[Problem]) -> list[Level]:
    levels = []
    for value in values:
        made = axis.read(value, place)  # type: ignore[arg-type]
        if isinstance(made, Problem):
            problems.append(made)
        else:
            levels.append(made)
    return levels


def paths_of(model: BlockModel) -> dict[str, None]:
    """Paths that a block varies, each once, as they come."""
    found: dict[str, None] = {}
    for sample in (model.random, model.latin_hypercube, model.sobol):
        found |= dict.fromkeys(sample.over if sample else ())
    found |= dict.fromkeys(model.grid or ())
    for point in model.list_ or ():
        found |= dict.fromkeys(point)
    for inner in (*(model.multiply or ()), *(model.add or ())):
        found |= paths_of(inner)
    return found


class Blocks:
    """Makes blocks from their models, and collects what is wrong with them.

    Attributes:
        levels: values of each axis that are to be tried before the first run: all of those that are written.
    """

    def __init__(
        self, axes: Mapping[str, Axis], problems: list[Problem], text: Callable[[Path], str] = path_text
    ) -> None:
        """
        Args:
            problems: found ones are put here.
            text: a path of the study as messages have it.
        """
        self._axes, self._problems, self._text = axes, problems, text
        self.levels: dict[str, dict[Level, str]] = {path: {} for path in axes}

    def make(self, model: BlockModel, place: Path) -> Block:
        """A block; empty where it has problems."""
        if model.grid is not None:
            return self._grid(model.grid, (*place, "grid"))
        if model.list_ is not None:
            points = [self._point(one, (*place, "list", n)) for n, one in enumerate(model.list_)]
            return _Listed(points)
        if model.multiply is not None:
            return self._multiply(model.multiply, (*place, "multiply"))
        if model.add is not None:
            return Sum([self.make(one, (*place, "add", n)) for n, one in enumerate(model.add)])
        for kind in ("random", "latin-hypercube", "sobol"):
            sample = getattr(model, kind.replace("-", "_"))
            if sample is not None:
                return self._sample(kind, sample, (*place, kind))
        raise AssertionError("a block has a kind")

    def _note(self, axis: Axis, levels: Sequence[Level], place: str) -> None:
        for level in levels:
            self.levels[axis.path].setdefault(level, place)

    def _point(self, values: Mapping[str, object], place: Path) -> Point:
        point: Point = {}
        for path, value in values.items():
            axis, where = self._axes.get(path), self._text((*place, path))
            for level in _levels(axis, [value], where, self._problems) if axis else ():
                point[path] = level
                self._note(axis, [level], where)
        return point

    def _grid(self, values: Mapping[str, list[object] | RangeModel], place: Path) -> Block:
        blocks = []
        for path, given in values.items():
            axis = self._axes.get(path)
            if axis is None:
                continue
            where = self._text((*place, path))
            levels = self._range(axis, given, where) if isinstance(given, RangeModel) else []
            if not isinstance(given, RangeModel):
                levels = _levels(axis, given, where, self._problems)
            self._note(axis, levels, where)
            blocks.append(_Listed([{path: level} for level in levels]))
        return _Product(blocks)

    def _range(self, axis: Axis, given: RangeModel, place: str) -> list[Level]:
        found = len(self._problems)
        ends = _levels(axis, [given.low, given.high], place, self._problems)
        if len(self._problems) > found:
            return []
        numbers = [one.shown for one in ends if isinstance(one.shown, int | float)]
        if len(numbers) < 2:
            self._problems.append(Problem(place, f"{axis.path} has no range: its values are no numbers"))
            return []
        low, high = map(float, numbers)
        if given.spacing == "log" and (low <= 0.0 or high <= 0.0):
            self._problems.append(Problem(place, f"{axis.path}: a range with log spacing must be positive"))
            return []
        spread = np.geomspace if given.spacing == "log" else np.linspace
        made = spread(low, high, given.count).tolist()
        whole = axis.whole(ends)
        # What stands at equal ratios is whole but for its rounding: 1, 2, 4, 8.
        if whole and any(abs(one - round(one)) > 1e-9 * abs(one) for one in made):
            what = f"{axis.path} takes whole numbers; the range holds others"
            allowed = f"{listed([f'{one:.6g}' for one in made])}"
            self._problems.append(Problem(place, what, allowed, "Choose another count, or list the values."))
            return []
        return [ends[0], *(axis.at(one, whole) for one in made[1:-1]), ends[1]]

    def _multiply(self, models: Sequence[BlockModel], place: Path) -> Block:
        taken: dict[str, int] = {}
        for number, model in enumerate(models):
            for path in paths_of(model):
                if path in taken:
                    what = f"{path} stands in blocks {taken[path]} and {number}, which are multiplied"
                    self._problems.append(Problem(self._text(place), what, remedy="Let one of them vary it."))
                taken.setdefault(path, number)
        return _Product([self.make(one, (*place, n)) for n, one in enumerate(models)])

    def _sample(self, kind: str, model: SampleModel, place: Path) -> Block:
        values: dict[str, _Distribution] = {}
        for path, drawn in model.over.items():
            axis = self._axes.get(path)
            if axis is not None:
                where = self._text((*place, "over", path))
                values[path] = _Distribution(axis, drawn, where, self._problems)
                self._note(axis, values[path].ends, where)
        return _Drawn(_cube(kind, model.count, len(values), model.seed), values)


def _cube(kind: str, count: int, axes: int, seed: int) -> np.ndarray:
    if kind == "random" or not axes:
        return np.random.default_rng(seed).random((count, axes))
    from scipy.stats import qmc

    with warnings.catch_warnings():
        # A count that is no power of two costs balance, which is the author's to weigh.
        warnings.simplefilter("ignore", UserWarning)
        engine = qmc.Sobol if kind == "sobol" else qmc.LatinHypercube
        return engine(axes, rng=np.random.default_rng(seed)).random(count)


def seeds(model: RepeatsModel) -> list[dict[str, int]]:
    """Seeds of each repeat, by path."""
    made = []
    for repeat in range(model.count):
        drawn = np.random.SeedSequence([model.seed, repeat]).generate_state(len(model.into), np.uint32)
        made.append({path: int(one) % _SEEDS for path, one in zip(model.into, drawn, strict=True)})
    return made
