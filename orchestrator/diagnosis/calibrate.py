"""Learn what evidence is worth from simulated cases: `python -m orchestrator.diagnosis.calibrate`.

Cases are drawn by the challenge's rig, which is a program of its own; magnitudes go from strong to none.
What no catalogue holds is practised by striking the hidden effect, and what ties with it, off the answers.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize
from threadpoolctl import threadpool_limits

from .calibration import Calibration
from .hardware import weigh_rig
from .study import Array, Nominal, Role, Run, Study

__all__ = ["Practice", "learn", "main", "practise", "simulated_study"]

_SOFTWARE = ("dynamics", "controller")
_DIGITS = (9, 9, 6, 2, 4, 1)
# Cases are taken from a plan of so many, so that the first ones do not depend on how many are asked for.
_PLANNED = 1000
# Weight of a case whose effect was struck off, beside one as it was drawn.
_STRUCK = 0.1
# Log evidence from which an effect shows [nats].
_SHOWN = 10.0
# Where learned numbers begin, and how far the logarithm of each may stray: cases are few, and simulated.
_STRAY = 0.7


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
    weight: float = 1.0

    def struck(self) -> Practice | None:
        """The same case to someone whose catalogue lacks the effect; None where it hardly showed anyway."""
        gain = max((one.gain for one in self.answers if one.effects == self.truth), default=0.0)
        if not self.truth or gain < _SHOWN:
            return None
        ties = {tie for one in self.answers if one.effects == self.truth for tie in one.ties}
        gone = {*self.truth, *ties}
        kept = tuple(one for one in self.answers if not gone & set(one.effects))
        return Practice(("outside",), self.magnitude, kept, self.beside, _STRUCK)


@dataclass(frozen=True)
class _Answer:
    effects: tuple[str, ...]
    gain: float
    left: float
    ties: tuple[str, ...] = ()


def simulated_study(seed: int, number: int) -> tuple[Study, Any]:
    """A case of the challenge's rig with what it hides in the rig's hardware; train runs only."""
    from .challenge import draw, hidden

    pool = [one for one in hidden.HIDDEN.values() if one.place not in _SOFTWARE]
    plan = draw.plan_cases(_PLANNED, seed, pool, (), True)[number - 1]
    case = draw.draw_case(plan, seed, number)
    nominal = {
        name: Nominal(value, draw.tolerances(case.lab).get(name, 0.0))
        for name, value in case.lab.nominal.items()
    }
    specified = zip(
        ("encoder_noise", "force_noise", "encoder_resolution", "force_resolution"),
        (*draw.NOISE, 1e-6, 0.1),
        strict=True,
    )
    nominal |= {name: Nominal(value, 0.0) for name, value in specified}
    runs = []
    for index, run in enumerate(draw.RUNS):
        if run.role != "train":
            continue
        rows = [
            np.round(row, digits) for row, digits in zip(draw.make_run(case, index), _DIGITS, strict=True)
        ]
        names = ("desired_position", "desired_velocity", "encoder_position", "sensor_force")
        columns = dict(zip((*names, "compensated_force", "stiffness_estimate"), rows, strict=True))
        columns["time"] = 0.001 * np.arange(len(rows[0]))
        runs.append(Run(run.name, Role.TRAIN, run.mass, run.speed, columns))
    return Study(f"case-{number:04d}", 0.001, nominal, tuple(runs)), plan


def practise(seed: int, number: int) -> Practice:
    """Weigh one simulated case."""
    study, plan = simulated_study(seed, number)
    with threadpool_limits(limits=1, user_api="blas"):
        group = weigh_rig(study)
    answers = tuple(_Answer(one.effects, one.gain, one.left, one.ties) for one in group.answers)
    truth = tuple(sorted(one.id for one in plan.effects))
    return Practice(truth, plan.magnitude, answers, group.outside)


def _learned(x: Array, start: Calibration) -> Calibration:
    names = list(Calibration.__dataclass_fields__)
    return Calibration(
        **{name: getattr(start, name) * float(np.exp(v)) for name, v in zip(names, x, strict=True)}
    )


def loss(learned: Calibration, cases: Sequence[Practice]) -> float:
    """Mean negative log probability of the truth; ties of an answer count as it."""
    total = weight = 0.0
    for case in cases:
        p = learned.probabilities(case.answers, case.beside)
        if case.truth == ("outside",):
            right = p[-1]
        else:
            right = sum(
                q
                for q, one in zip(p, case.answers, strict=False)
                if one.effects == case.truth
                or (len(case.truth) == 1 == len(one.effects) and case.truth[0] in one.ties)
            )
        total -= case.weight * np.log(max(right, 1e-6))
        weight += case.weight
    return total / weight


def learn(cases: Sequence[Practice], start: Calibration | None = None) -> Calibration:
    """The numbers under which the truth of simulated cases is most probable."""
    start = start or Calibration()
    every = [*cases, *(one for case in cases if (one := case.struck()) is not None)]

    def cost(x: Array) -> float:
        return loss(_learned(x, start), every) * len(every) + 0.5 * float(np.sum((x / _STRAY) ** 2))

    size = len(Calibration.__dataclass_fields__)
    found = minimize(
        cost, np.zeros(size), method="Powell", bounds=[(-2.5, 2.5)] * size, options={"maxiter": 20}
    )
    return _learned(found.x, start)


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw cases, weigh them, learn, and write the calibration that comes with the product."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=28)
    parser.add_argument("--seed", type=int, default=20260)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seen", type=Path, help="keep weighed cases here, and go on from those there")
    options = parser.parse_args(arguments)
    done: dict[int, Practice] = {}
    if options.seen and options.seen.is_file():
        for line in options.seen.read_text(encoding="utf-8").splitlines():
            number, practice = _read(json.loads(line))
            done[number] = practice
    todo = [number for number in range(1, options.cases + 1) if number not in done]
    # Forked workers inherit threads' locks in whatever state they are.
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
        weigh_one = partial(practise, options.seed)
        waiting = {pool.submit(weigh_one, number): number for number in todo}
        for future in as_completed(waiting):
            number = waiting[future]
            done[number] = future.result()
            if options.seen:
                with options.seen.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(_written(number, done[number])) + "\n")
            print(f"{len(done)}/{options.cases}", flush=True)
    cases = [done[number] for number in sorted(done)]
    learned = learn(cases)
    learned.save(cases=len(cases), seed=options.seed, loss=round(loss(learned, cases), 4))
    print(learned)


def _written(number: int, one: Practice) -> list[Any]:
    answers = [[a.effects, a.gain, a.left, a.ties] for a in one.answers]
    return [number, one.truth, one.magnitude, answers, one.beside]


def _read(data: list[Any]) -> tuple[int, Practice]:
    number, truth, magnitude, answers, beside = data
    made = tuple(_Answer(tuple(a[0]), a[1], a[2], tuple(a[3])) for a in answers)
    return number, Practice(tuple(truth), magnitude, made, beside)


if __name__ == "__main__":
    main()
