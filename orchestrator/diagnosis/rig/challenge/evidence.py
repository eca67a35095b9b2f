"""Largest possible evidence in the logs of a case for its hidden effects, from the rig that made them."""

from __future__ import annotations

import itertools
import math
import zlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from .draw import NOISE, ROUGHNESS, RUNS, Case, changed, run_series, tolerances
from .hidden import Hidden
from .rig import FORCE_RESOLUTION, POSITION_RESOLUTION, TICK, Array, drive
from .rig_parameters import CALIBRATED

# Least evidence of an effect that should be named [nats].
CLEAR = 10.0

_FORCE_DIGITS, _STIFFNESS_DIGITS, _VELOCITY_DIGITS = 1e-4, 0.1, 1e-9
# First ticks of robot and sensor that do not count: how the robot moves as a log begins nobody has measured.
_BEGIN = 20
# Length of a spectrum [samples], and number of frequencies over which it is averaged.
_WINDOW, _BAND = 64, 8
# Of a tolerance or a usual size, for differences: small ones, and large ones for where small ones say about a
# dent alone.
_STEP, _WIDE = 0.1, 2.0
# Evidences between which it is sought more than once: below there is hardly any, and above no search leads
# to none; and what a further one must gain [nats].
_OPEN, _SETTLED = (0.5 * CLEAR, 10.0 * CLEAR), 0.2
_ROUNDS, _SHARES = 4, (1.0, 0.3, 0.1)
# Blocks of a run, and which of them is the force; coloured noise that rigs have, over the white one, and what
# a sample keeps of it (see `draw`).
_CHANNELS, _FORCE = 5, 2
_COLOURS = tuple(itertools.product((0.15, 0.2, 0.25), (0.8, 0.88, 0.95)))
# Sizes in which a rival is tried, how many rivals are fitted, and factors by which they are sized for that.
_SIZES, _NEAREST = (1.0, 0.3, 0.1), 3
_LEAST, _MOST, _LOOSE = 0.02, 5.0, 1e-4


@dataclass(frozen=True)
class _Sight:
    """Outputs of the blocks driven by the logs of a case, over the noise of each channel.

    The force's noise is that of a rig without what is weighed: coarse steps and coloured noise that are there
    anyway hide some of it. Steps count as noise of their own; what noise carries across them is not known.

    Attributes:
        without: parameters of that rig.
    """

    case: Case
    logs: list[Array]
    without: Mapping[str, float]

    @property
    def force_noise(self) -> float:
        """Deviation of the force's white noise [N]."""
        return math.hypot(
            NOISE[1], max(FORCE_RESOLUTION, self.without.get("force_step", 0.0)) / math.sqrt(12.0)
        )

    @property
    def colour(self) -> tuple[float, float]:
        """Deviation of coloured noise over that of the white noise, and its correlation per sample."""
        kind = "coloured" if self.without.get("coloured", 0.0) > self.without["colour"] else "colour"
        return self.without[kind] / self.force_noise, self.without[f"{kind}_keep"]

    def measured(self, values: Mapping[str, float]) -> Array:
        """Measured signals of a rig with some parameters in the training runs, stacked."""
        return np.concatenate(self.parts(values))

    def parts(self, values: Mapping[str, float]) -> list[Array]:
        """The same by run and channel."""
        if self.without.get("force_step", 0.0) > 0.0:
            values = {**values, "force_step": 0.0}
        train = [index for index, plan in enumerate(RUNS) if plan.role == "train"]
        return [part for index in train for part in self._blocks(index, values)]

    def _blocks(self, index: int, values: Mapping[str, float]) -> list[Array]:
        """Outputs of the blocks for a run."""
        case, plan = self.case, RUNS[index]
        series = run_series(case, index, values)
        out = drive(case.lab, values, plan.mass, plan.speed, self.logs[index], series)
        n = out.shape[1]
        velocity = np.hypot(_VELOCITY_DIGITS / np.sqrt(6.0), TICK / plan.mass * _FORCE_DIGITS / np.sqrt(12.0))
        return [
            out[1, : n - 1] / velocity,
            out[2, _BEGIN:] / np.hypot(NOISE[0], POSITION_RESOLUTION / np.sqrt(12.0)),
            _whitened(out[3, _BEGIN:] / self.force_noise, *self.colour),
            # Rounded inputs pass through the controller's differences: not all of its digits count.
            out[4] / np.hypot(3.0 * _FORCE_DIGITS, 0.02 * FORCE_RESOLUTION),
            out[5] / np.hypot(3.0 * _STIFFNESS_DIGITS, 0.02 * FORCE_RESOLUTION / 5e-4),
        ]


@dataclass(frozen=True)
class _Place:
    """A rig, and how its parameters may deviate.

    Attributes:
        parameters: from where they deviate, as the lab believes them; free: by what they may.
        at: how far they do; firm: what their deviates cost, each of shape (free,).
    """

    parameters: Mapping[str, float]
    free: Mapping[str, float]
    at: Array
    firm: Array

    @staticmethod
    def of(case: Case, parameters: Mapping[str, float]) -> _Place:
        """A rig of a case, with its deviations."""
        believed = dict.fromkeys(ROUGHNESS, 0.0)
        believed |= {parameter: case.lab.nominal[name] for name, parameter in CALIBRATED.items()}
        free = _usual(case)
        deviations = {parameter: case.plain[parameter] - believed[parameter] for parameter in free}
        at = np.array([deviations[parameter] / size for parameter, size in free.items()])
        start = {parameter: value - deviations.get(parameter, 0.0) for parameter, value in parameters.items()}
        return _Place(start, free, at, np.ones(len(free)))

    @property
    def parameters_here(self) -> dict[str, float]:
        """The parameters there."""
        moved = {
            parameter: self.parameters[parameter] + size * by
            for (parameter, size), by in zip(self.free.items(), self.at, strict=True)
        }
        return {**self.parameters, **moved}


@dataclass(frozen=True)
class Imitation:
    """How well other effects imitate the hidden ones.

    Attributes:
        beyond: log evidence for what is hidden over them [nats].
        like: their ids; fewer than were asked for where a further one brings nothing nearer.
        place: the rig that has them.
    """

    beyond: float
    like: tuple[str, ...]
    place: _Place


def visibility(case: Case, logs: list[Array], rest: Case | None = None, chance: bool = False) -> float:
    """Log evidence [nats] for the hidden effects over none, for one who knew their exact size.

    Each block is driven by the logged inputs with and without the effects, with the same random numbers. d is
    the difference of the measured signals over their noise. z holds the deviations of calibrated numbers from
    the lab's values over their tolerances, and roughness over its usual size. The evidence is half the
    minimum of d'd + z'z, minus the same with the effects. So the part that calibration, roughness or other
    hidden effects of any size and shape could explain does not count. The noise of the force includes its
    changes by other hidden effects, and the force is whitened by the noise of the rig's sensor.

    The draws of an effect that is drawn again at each sample are unknown; only its spectrum can be estimated.
    With r the power of noise and of the rest of d, over that of noise alone, each frequency gives
    r - 1 - ln r (Whittle, J. R. Stat. Soc. B 15, 1953). The noise of the force may be as coloured as that of
    any rig.

    Args:
        logs: of the case, by `RUNS`; the training runs are used.
        rest: the case with the other hidden effects alone, to compare with; by default, there are none.
        chance: whether the effects draw.
    """
    sight = _Sight(case, logs, case.plain if rest is None else rest.values)
    aim = sight.parts(case.values)
    target = np.concatenate(aim)
    place, own = _Place.of(case, sight.without), _own(sight, target)
    others = () if rest is None else tuple(one for one in rest.plan.effects if not one.chance)
    if rest is not None and others:
        place = _least(sight, place, target, own)[2]
        for one in others:
            place = _with_any_size(place, place.parameters, rest.plain, rest.hidden[one.id])
    evidence, left, _ = _least(sight, place, target, own)
    if not chance:
        return max(evidence - own, 0.0)
    lengths = [len(one) for one in aim]
    colour = sight.colour
    total = 0.0
    for index, difference in enumerate(np.split(left, np.cumsum(lengths)[:-1])):
        force = index % _CHANNELS == _FORCE
        total += _spectral_evidence(difference, colour if force else (0.0, 0.0), _COLOURS if force else ())
    return total


def imitated(case: Case, logs: list[Array], rivals: Sequence[Hidden], most: int = 1) -> list[Imitation]:
    """Log evidence [nats] for the hidden effects over the best single other one, the best two, and so on.

    As `visibility`, which this cannot exceed, but the part that other effects imitate does not count either.
    Each rival is tried in several sizes and shapes. The nearest are fitted by a few steps from there, so that
    the result is an upper bound. A second rival is searched for beside the best one.

    Args:
        rivals: effects that do not draw.
        most: how many of them together.
    Returns: one for each number of rivals, beginning with one.
    """
    sight = _Sight(case, logs, case.plain)
    target = sight.measured(case.values)
    evidence, _, place = _descended(sight, _Place.of(case, case.plain), target)
    best, own = Imitation(evidence, (), place), _own(sight, target)
    found = []
    for _ in range(most):
        others = [one for one in rivals if one.id not in best.like]
        best = _nearer(sight, target, best, others, own)
        found.append(replace(best, beyond=max(best.beyond - own, 0.0)))
    return found


def _own(sight: _Sight, target: Array) -> float:
    """Half the minimum of d'd + z'z of the true rig, hidden effects included."""
    return _descended(sight, _Place.of(sight.case, sight.case.values), target)[0]


def _nearer(
    sight: _Sight, target: Array, before: Imitation, rivals: Sequence[Hidden], own: float
) -> Imitation:
    """An imitation with the further rival that improves it most.

    Args:
        own: see `_own`.
    """
    place = before.place
    here = place.parameters_here
    plain, jacobian = _linear(sight, place)
    inner = np.linalg.inv(np.diag(place.firm) + jacobian.T @ jacobian)
    off = target - plain
    rest = jacobian.T @ off - place.firm * place.at
    near: list[tuple[float, Hidden, dict[str, float]]] = []
    for rival in rivals:
        rng = np.random.default_rng(zlib.crc32(rival.id.encode()))
        tries = []
        for size in _SIZES:
            drawn = rival.draw(rng, size)
            moved = sight.measured(changed(here, rival, drawn)) - plain
            explained = inner @ (jacobian.T @ moved)
            square = float(moved @ moved - (jacobian.T @ moved) @ explained)
            along = float(moved @ off - rest @ explained)
            if math.isfinite(square) and square > 0.0:
                tries.append((-(along**2) / square, rival, _scaled(drawn, along / square)))
        near += sorted(tries, key=lambda one: one[0])[:1]
    best = before
    for _, rival, drawn in sorted(near, key=lambda one: one[0])[:_NEAREST]:
        beside = _with_any_size(place, changed(place.parameters, rival, drawn), place.parameters, drawn)
        left, _, reached = _descended(sight, beside, target)
        if left < best.beyond:
            best = Imitation(left, (*before.like, rival.id), reached)
    if best is before:
        return best
    # Once more from there, with derivatives of that place.
    left, _, reached = _least(sight, best.place, target, own)
    return replace(best, beyond=min(left, best.beyond), place=reached)


def _with_any_size(
    place: _Place, parameters: Mapping[str, float], before: Mapping[str, float], drawn: Collection[str]
) -> _Place:
    """A place with an effect that may have any size and shape, whatever its parameters are calibrated to.

    Args:
        parameters: with the effect; before: without it.
        drawn: its parameters.
    """
    own = {parameter: abs(parameters[parameter] - before.get(parameter, 0.0)) for parameter in drawn}
    free = {**place.free, **{parameter: one for parameter, one in own.items() if one}}
    start, firm = np.zeros(len(free)), np.ones(len(free))
    start[: len(place.at)], firm[: len(place.at)] = place.at, place.firm
    moved = [name in own for name in free]
    start[moved], firm[moved] = 0.0, _LOOSE
    return _Place(parameters, free, start, firm)


def _scaled(drawn: Mapping[str, float], by: float) -> dict[str, float]:
    """Draws of an effect with its size, the first entry, multiplied by a factor; limits are hardly scaled."""
    size = next(iter(drawn))
    return {**drawn, size: drawn[size] * by} if _LEAST < abs(by) < _MOST else dict(drawn)


def _usual(case: Case) -> dict[str, float]:
    """Standard deviations of calibration and roughness, by parameter."""
    sigma = tolerances(case.lab)
    return {parameter: sigma[name] for name, parameter in CALIBRATED.items() if sigma[name] > 0.0} | ROUGHNESS


def _linear(sight: _Sight, place: _Place, by: float = _STEP) -> tuple[Array, Array]:
    """Measured signals at a place, shape (measured,), and their derivatives, shape (measured, free).

    Args:
        by: step of the differences.
    """

    def measured(z: Array) -> Array:
        return sight.measured(replace(place, at=z).parameters_here)

    plain = measured(place.at)
    steps = by * np.eye(len(place.at))
    return plain, np.stack([(measured(place.at + one) - plain) / by for one in steps], axis=1)


def _least(sight: _Sight, place: _Place, target: Array, own: float) -> tuple[float, Array, _Place]:
    """Half the minimum of d'd + z'z, started from a place; see `visibility`.

    What a drive's acceleration ripples with a command's steps, a tool passes on to the force, and a delay
    of a small part of a tick moves samples along it: derivatives say which way that goes, and not which way
    a larger one would. So it is sought by small differences alone, and by large ones first, too.

    Args:
        own: see `_own`.
    Returns: it, d and the place there.
    """
    best = _descended(sight, place, target)
    low, high = _OPEN
    if not own + low < best[0] < own + high:
        return best
    wide = _descended(sight, place, target, _WIDE)[2]
    best = min(best, _descended(sight, wide, target), key=lambda one: one[0])
    for _ in range(_ROUNDS):
        further = _descended(sight, best[2], target)
        if further[0] > best[0] - _SETTLED:
            break
        best = further
    return best


def _descended(sight: _Sight, place: _Place, target: Array, by: float = _STEP) -> tuple[float, Array, _Place]:
    """The same by Gauss-Newton steps with the derivatives of that place, shortened if needed.

    Args:
        by: see `_linear`.
    """
    plain, jacobian = _linear(sight, place, by)
    inner = np.diag(place.firm) + jacobian.T @ jacobian

    def costs(at: Array, left: Array) -> float:
        with np.errstate(over="ignore", invalid="ignore"):
            return 0.5 * float(left @ left + place.firm * at @ at)

    here, left = place.at, target - plain
    best = costs(here, left)
    for _ in range(_ROUNDS):
        step = np.linalg.solve(inner, jacobian.T @ left - place.firm * here)
        for share in _SHARES:
            ahead = here + share * step
            off = target - sight.measured(replace(place, at=ahead).parameters_here)
            cost = costs(ahead, off)
            if cost < best:
                here, left, best = ahead, off, cost
                break
        else:
            break
    return best, left, replace(place, at=here)


def _spectral_evidence(
    difference: Array, own: tuple[float, float], others: Sequence[tuple[float, float]]
) -> float:
    """See `visibility`; the power is taken over windows and bands.

    Args:
        difference: whitened by `own`.
        own: coloured noise that is there anyway: its deviation over that of the white noise, and what a
            sample keeps of it.
        others: coloured noise that a rig without the effect may have, too; the likest counts.
    """
    windows = difference[: len(difference) // _WINDOW * _WINDOW].reshape(-1, _WINDOW)
    power = np.abs(np.fft.rfft(windows, axis=1)[:, : _WINDOW // 2]) ** 2 / _WINDOW
    bands = power.reshape(len(windows), -1, _BAND).mean(axis=2) + 1.0
    evidence = []
    for other in (own, *others):
        ratio = bands * _coloured(*own) / _coloured(*other)
        evidence.append(float(_BAND * np.sum(ratio - 1.0 - np.log(ratio))))
    return min(evidence)


def _coloured(deviation: float, keep: float) -> Array:
    """Power of unit white noise plus a first-order process, averaged over bands."""
    turn = 2.0 * np.pi * np.arange(_WINDOW // 2) / _WINDOW
    power = 1.0 + deviation**2 * (1.0 - keep**2) / (1.0 - 2.0 * keep * np.cos(turn) + keep**2)
    return power.reshape(-1, _BAND).mean(axis=1)


def _whitened(force: Array, deviation: float, keep: float) -> Array:
    """A signal after the filter that whitens unit white noise plus a first-order process.

    Both together are white noise through g (1 - t/z)/(1 - keep/z), whose power is theirs.
    """
    at_zero = 1.0 + keep**2 + deviation**2 * (1.0 - keep**2)
    if deviation <= 0.0:
        return force
    # g2 (1 + t2) = at_zero and g2 t = keep.
    half = at_zero / (2.0 * keep)
    t = half - math.sqrt(half**2 - 1.0)
    return lfilter([1.0, -keep], [1.0, -t], force) / math.sqrt(keep / t)
