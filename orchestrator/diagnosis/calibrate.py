"""Learn what evidence is worth from simulated cases: `python -m orchestrator.diagnosis.calibrate`.

Cases are drawn by the challenge's rig, which is a program of its own; magnitudes go from strong to nearly
none, some hide two effects or none, of some the logs are deformed in ways that no catalogue holds. First it
is learned how rough rigs are that hide nothing; then, from cases weighed so, what log evidence is worth.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize
from threadpoolctl import threadpool_limits

from ..provenance import origin
from .calibration import Calibration
from .hardware import weigh_rig
from .practice import simulated_study
from .rough import learn_roughness, strayed_by_number
from .study import Array

__all__ = ["Practice", "learn", "loss", "main", "practise", "simulated_study"]

# How far the logarithm of each learned number may stray from where it begins: cases are few, and simulated.
_STRAY = 0.7
_NUMBERS = tuple(name for name in Calibration.__dataclass_fields__ if name != "roughness")

# A real rig leaves more than a simulated one: the map is learned of each case as it is, and with so much more
# left unexplained [nats].
_ROUGHER = (0.0, 20.0)


@dataclass(frozen=True)
class Practice:
    """What weighing gave for a simulated case.

    Attributes:
        truth: ids, ("outside",), or none; magnitude: of the effects.
        answers: effects, log evidence, what is left, ties; none first.
        beside: see `Group.outside`.
    """

    truth: tuple[str, ...]
    magnitude: float
    answers: tuple[_Answer, ...]
    beside: float

    def right(self, answer: _Answer) -> bool:
        """Whether an answer names what is hidden, ties as declared."""
        missing = set(self.truth) - set(answer.effects)
        return len(answer.effects) == len(self.truth) and missing <= set(answer.ties)


@dataclass(frozen=True)
class _Answer:
    effects: tuple[str, ...]
    gain: float
    left: float
    ties: tuple[str, ...] = ()


def practise(seed: int, roughness: Mapping[str, float], number: int) -> Practice:
    """Weigh one simulated case."""
    study, plan = simulated_study(seed, number)
    with threadpool_limits(limits=1, user_api="blas"):
        group = weigh_rig(study, rough=roughness)
    answers = tuple(_Answer(one.effects, float(one.gain), float(one.left), one.ties) for one in group.answers)
    truth = ("outside",) if plan.kind == "outside" else tuple(sorted(one.id for one in plan.effects))
    return Practice(truth, plan.magnitude, answers, float(group.outside))


def _rougher(one: Practice, more: float) -> Practice:
    """The same case on a rig that is rough in ways that nothing here simulates: each answer leaves more."""
    return replace(one, answers=tuple(replace(answer, left=answer.left + more) for answer in one.answers))


def _learned(x: Array, start: Calibration) -> Calibration:
    return replace(
        start, **{name: getattr(start, name) * float(np.exp(v)) for name, v in zip(_NUMBERS, x, strict=True)}
    )


def loss(learned: Calibration, cases: Sequence[Practice]) -> float:
    """Mean negative log probability of the truth; ties of an answer count as it."""
    total = 0.0
    for case in cases:
        p = learned.probabilities(case.answers, case.beside)
        if case.truth == ("outside",):
            right = p[-1]
        else:
            right = sum(q for q, one in zip(p, case.answers, strict=False) if case.right(one))
        total -= np.log(max(right, 1e-6))
    return total / len(cases)


def learn(cases: Sequence[Practice], start: Calibration | None = None) -> Calibration:
    """The numbers under which the truth of simulated cases is most probable."""
    start = start or Calibration()

    def cost(x: Array) -> float:
        return loss(_learned(x, start), cases) * len(cases) + 0.5 * float(np.sum((x / _STRAY) ** 2))

    size = len(_NUMBERS)
    found = minimize(
        cost, np.zeros(size), method="Powell", bounds=[(-2.5, 2.5)] * size, options={"maxiter": 20}
    )
    return _learned(found.x, start)


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw cases, weigh them, learn, and write the calibration that comes with the product."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=300)
    parser.add_argument("--bare", type=int, default=40, help="rigs that hide nothing, for the roughness")
    parser.add_argument("--seed", type=int, default=20261)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seen", type=Path, help="keep weighed cases here, and go on from those there")
    options = parser.parse_args(arguments)
    seen = json.loads(options.seen.read_text("utf-8")) if options.seen and options.seen.is_file() else {}
    done = {int(number): _read(data) for number, data in seen.get("cases", {}).items()}
    # Forked workers inherit threads' locks in whatever state they are.
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
        if "roughness" not in seen:
            bare = pool.map(partial(strayed_by_number, options.seed + 1), range(1, options.bare + 1))
            seen["roughness"] = dict(learn_roughness(list(bare)))
            print(seen["roughness"], flush=True)
        weigh_one = partial(practise, options.seed, seen["roughness"])
        todo = [number for number in range(1, options.cases + 1) if number not in done]
        waiting = {pool.submit(weigh_one, number): number for number in todo}
        for future in as_completed(waiting):
            number = waiting[future]
            done[number] = future.result()
            if options.seen:
                seen.setdefault("cases", {})[str(number)] = _written(done[number])
                options.seen.write_text(json.dumps(seen), encoding="utf-8")
            print(f"{len(done)}/{options.cases}", flush=True)
    cases = [done[number] for number in sorted(done)]
    rougher = [_rougher(one, more) for more in _ROUGHER for one in cases]
    learned = learn(rougher, Calibration(roughness=seen["roughness"]))
    learned.save(
        cases=len(cases),
        bare=options.bare,
        seed=options.seed,
        loss=round(loss(learned, cases), 4),
        **{name: value for name, value in origin().items() if name != "platform"},
    )
    print(learned)


def _written(one: Practice) -> list[Any]:
    answers = [[a.effects, a.gain, a.left, a.ties] for a in one.answers]
    return [one.truth, one.magnitude, answers, one.beside]


def _read(data: list[Any]) -> Practice:
    truth, magnitude, answers, beside = data
    made = tuple(_Answer(tuple(a[0]), a[1], a[2], tuple(a[3])) for a in answers)
    return Practice(tuple(truth), magnitude, made, beside)


if __name__ == "__main__":
    main()
