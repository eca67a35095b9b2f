"""What the lab can do to distinguish an answer from its rivals: another run, or one more sensor."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .choice import Rival
from .fits import Weighed
from .law_fit import Candidate, Fitted
from .places import Runs
from .search import Search

Array = NDArray[np.float64]
# Runs that can be made: amplitude of what is fed, and its speed, over those of the first run.
_RUNS = (
    (2.0, 1.0, "with twice the amplitude"), (0.5, 1.0, "with half the amplitude"),
    (1.0, 2.0, "at twice the speed"), (1.0, 0.5, "at half the speed"),
)  # fmt: skip
# Differences that a run must show, over the noise, and that a sensor must, over the spread of its signal.
_SEEN, _SHARE = 3.0, 0.05
# Least probability of a rival that is worth an experiment, and rivals that experiments separate.
_LIKELY, _MOST = 0.02, 4


@dataclass(frozen=True)
class FittedAnswer:
    """Laws with their numbers, as the runs are simulated with them.

    Attributes:
        constants: parameters, then numbers. starts: start states of each run.
    """

    laws: tuple[Candidate, ...]
    constants: Array
    starts: Sequence[Array]

    @property
    def name(self) -> str:
        """Of the laws."""
        return " + ".join(one.name for one in self.laws) or "no law"


@dataclass(frozen=True)
class Experiment:
    """One experiment that separates two answers.

    Attributes:
        what: is to be done. rival: that it separates from the answer.
        difference: of both answers, a root mean square. Of another run it is over the noise; of another
            sensor, in percent of its signal's spread.
        before: difference in the runs that there are, over the noise.
    """

    what: str
    rival: str
    difference: float
    before: float


def experiments_for(
    search: Search, weighed: Sequence[Weighed], chosen: int,
    elsewhere: Sequence[Fitted], rivals: Sequence[Rival],
) -> list[Experiment]:  # fmt: skip
    """What separates the answer from likely rivals, and from laws that act the same on these logs."""
    search.model.study = search.study
    best, found, _ = weighed[chosen]
    probable = [one.fitted for one in rivals if one.probability > _LIKELY]
    likely = {id(one) for one in [*elsewhere, *probable][:_MOST]}
    others = [
        FittedAnswer(one.laws, two.constants, two.starts) for one, two, _ in weighed if id(one) in likely
    ]
    wires = [
        {str(one.sources[0]), str(one.target)}
        for one in search.study.prepared.system.connections
        if len(one.sources) == 1
    ]
    for k, law in enumerate(best.laws):
        for twin in search.twins.get(law.name, [])[:_MOST]:
            if twin.law is law.law and {law.place.name, twin.place.name} in wires:
                continue  # both ends of a connection are one place of the machine
            constants = found.constants
            if twin.law is not law.law:
                at = len(search.model.nominal) + sum(len(one.law.numbers) for one in best.laws[:k])
                constants = np.r_[constants[:at], twin.numbers, constants[at + len(law.law.numbers) :]]
            laws = (*best.laws[:k], twin, *best.laws[k + 1 :])
            others.append(FittedAnswer(laws, constants, found.starts))
    return separating(search.runs, FittedAnswer(best.laws, found.constants, found.starts), others)


def separating(runs: Runs, answer: FittedAnswer, rivals: Sequence[FittedAnswer]) -> list[Experiment]:
    """For each rival the experiment that separates it best, if one does."""
    if not rivals:
        return []
    runs_made, logged = _first_run_again(runs, answer), _outputs(runs, answer)
    found = []
    for rival in rivals:
        tried = [
            *_other_runs(_differences(runs, runs_made, _first_run_again(runs, rival)), runs, rival),
            *_sensors(runs, logged, _outputs(runs, rival), rival),
        ]
        if tried:
            found.append(max(tried, key=lambda one: one.difference / max(one.before, 1.0)))
    return found


def _first_run_again(runs: Runs, one: FittedAnswer) -> list[Array]:
    """Compared signals of the first run: as it is, and with each of the other inputs."""
    ext, held, _, start = runs.data[0]
    found = []
    for amplitude, speed in ((1.0, 1.0), *((a, s) for a, s, _ in _RUNS)):
        samples = np.arange(0.0, len(ext) - 1 + 0.5 * speed, speed)
        columns = np.array([np.interp(samples, np.arange(len(ext)), column) for column in ext.T])
        fed = np.ascontiguousarray(amplitude * columns.reshape(ext.shape[1], len(samples)).T)
        found.append(_simulated(runs, one, fed, held, start)[0])
    return found


def _differences(runs: Runs, ours: Sequence[Array], theirs: Sequence[Array]) -> list[float]:
    """Root mean squares of the differences of runs, over the noise."""
    with np.errstate(invalid="ignore", over="ignore"):
        return [
            float(np.sqrt(np.mean(((a - b) / runs.model.noise) ** 2)))
            for a, b in zip(ours, theirs, strict=True)
        ]


def _other_runs(differences: Sequence[float], runs: Runs, rival: FittedAnswer) -> Iterator[Experiment]:
    """The first run again, with other inputs."""
    before, *others = differences
    for (*_, what), one in zip(_RUNS, others, strict=True):
        if np.isfinite(one) and one > max(_SEEN, 2.0 * before):
            yield Experiment(f"repeat the run {runs.runs[0].name} {what}", rival.name, one, before)


def _outputs(runs: Runs, one: FittedAnswer) -> Array:
    """All outputs of all runs, one run after the other, shape (samples, outputs)."""
    first, settled = len(runs.model.states) + len(runs.model.inputs), runs.model.study.settled
    return np.vstack([
        _simulated(runs, one, ext, held, begin)[1][settled:, first:]
        for (ext, held, *_), begin in zip(runs.data, one.starts, strict=True)
    ])  # fmt: skip


def _sensors(runs: Runs, ours: Array, theirs: Array, rival: FittedAnswer) -> Iterator[Experiment]:
    """Outputs that are not compared yet and in which the two differ."""
    model = runs.model
    noise = dict(zip(model.compared, model.noise, strict=True))
    with np.errstate(invalid="ignore", over="ignore"):  # where one of them runs away
        sizes = np.sqrt(np.mean((ours - theirs) ** 2, axis=0))
    before = max(sizes[model.outputs.index(port)] / noise[port] for port in model.compared)
    for port, size, spread in zip(model.outputs, sizes, ours.std(axis=0), strict=True):
        separates = 0.0 < _SHARE * spread < size < np.inf and np.isfinite(before)
        if port not in noise and port not in model.fed and separates:
            what = f"log {port}, where the two differ by {100 * size / spread:.2g} % of the signal's spread"
            yield Experiment(what, rival.name, 1e2 * float(size / spread), float(before))


def _simulated(runs: Runs, one: FittedAnswer, ext: Array, held: Any, start: Array) -> tuple[Array, Array]:
    inserted = [law.inserted for law in one.laws]
    z = np.concatenate([start, np.zeros(sum(law.states for law in inserted)), one.constants])
    return runs.simulated(ext, held, z, inserted, signals=True)
