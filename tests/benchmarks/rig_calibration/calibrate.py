"""Learn the map from evidence to probability: `python -m tests.benchmarks.rig_calibration.calibrate`.

Cases are drawn by the challenge's rig, which is a program of its own; magnitudes go from strong to nearly
none, some hide two effects or none, of some the logs are deformed in ways that no catalogue holds, and some
hide the challenge's known kinds outside the catalogue; its fresh ones are kept for blind checks. First it is
learned how rough rigs are that hide nothing; then, from cases weighed so, what each effect leaves
unexplained since no rig has the catalogue's very form of it, and what log evidence is worth.
"""

from __future__ import annotations

import argparse
import json
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice, product
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from orchestrator.base.atomic_files import write_text
from orchestrator.base.errors import OrchestratorError
from orchestrator.base.provenance import origin
from orchestrator.diagnosis.rig.answers import Answer, complete
from orchestrator.diagnosis.rig.calibration import FILE, Calibration
from orchestrator.diagnosis.rig.challenge.draw import Plan
from orchestrator.diagnosis.rig.challenge.hidden import HARDWARE, HIDDEN, SOFTWARE
from orchestrator.diagnosis.rig.challenge.outside import OUTSIDE
from orchestrator.diagnosis.rig.hardware import weigh_rig
from orchestrator.fmi.workers import Pool, Work, pool_of

from .learning import WeighedCase, learn, learn_leaves, loss
from .roughness_learning import learn_roughness, roughness_problem_of_rig
from .simulated_cases import simulated_study

__all__ = ["main", "weigh_simulated"]

# Where the learning of `Calibration.form` begins.
_FORM = 1.0
# Magnitudes at which each effect is practised on besides, so that what it leaves shows.
_FORMS = (1.0, 0.5)
# How often each known kind outside the catalogue is practised on, and the magnitudes that it has then.
_TIMES, _FROM, _TO = 3, 0.03, 1.2


def weigh_simulated(
    seed: int, roughness: Mapping[str, Sequence[float]], number: int, plan: Plan | None = None
) -> WeighedCase:
    """Weigh one simulated case; plan as that of `simulated_cases.simulated_case`."""
    study, plan = simulated_study(seed, number, plan=plan)
    with threadpool_limits(limits=1, user_api="blas"):
        group = weigh_rig(study, rough=roughness)
    answers = tuple(
        replace(
            one,
            gain=float(one.gain),
            left=float(one.left),
            random=float(one.random),
            numerics=float(one.numerics),
            size=float(one.size),
            parts=tuple(map(float, one.parts)),
            fit=None,
            noises=(),
        )
        for one in group.answers
    )
    truth = ("outside",) if plan.kind == "outside" else tuple(sorted(one.id for one in plan.effects))
    return WeighedCase(truth, plan.magnitude, answers, float(group.outside))


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw cases, weigh them, learn, and write the shipped calibration."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=300)
    parser.add_argument("--bare", type=int, default=40, help="rigs that hide nothing, for the roughness")
    parser.add_argument("--forms", type=int, help="cases of one clear effect each; by default, two of each")
    parser.add_argument(
        "--kinds",
        metavar="N|all",
        help="of the known kinds outside the catalogue, the first N, or all; by default, those of the "
        "calibration that comes with the product",
    )
    parser.add_argument("--seed", type=int, default=20261)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seen", type=Path, help="keep weighed cases here, and go on from those there")
    parser.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="a Dask cluster that weighs")
    parser.add_argument("--out", type=Path, default=FILE, help="by default, what comes with the product")
    options = parser.parse_args(arguments)
    made_of = {"seed": options.seed, "bare": options.bare}
    seen: dict[str, Any] = {"made_of": made_of}
    if options.seen and options.seen.is_file():
        seen = json.loads(options.seen.read_text("utf-8"))
        if seen.get("made_of") != made_of:
            mismatch = f"{options.seen} is of {seen.get('made_of')}, not of {made_of}"
            parser.error(f"--seen: {mismatch}: name another file")
    try:
        kinds = _chosen_kinds(options.kinds)
    except OrchestratorError as error:
        parser.error(str(error))
    pool = pool_of(options.scheduler, options.jobs)
    if "roughness" not in seen:
        bare = _outcomes(
            pool, Work(roughness_problem_of_rig, payload=options.seed + 1), range(1, options.bare + 1)
        )
        seen["roughness"] = dict(learn_roughness([one for _, one in sorted(bare, key=lambda one: one[0])]))
        print(seen["roughness"], flush=True)

    def weighed(kind: str, work: Work, tasks: Mapping[int, Any]) -> list[WeighedCase]:
        """Cases of a kind by number, including stored ones; each is stored as soon as it is weighed."""
        done = {int(number): _read(data) for number, data in seen.get(kind, {}).items()}
        numbers = {task: number for number, task in tasks.items() if number not in done}
        for task, one in _outcomes(pool, work, list(numbers)):
            done[numbers[task]] = one
            if options.seen:
                seen.setdefault(kind, {})[str(numbers[task])] = _written(one)
                write_text(options.seen, json.dumps(seen))
            print(f"{kind} {len(done)}/{len(tasks)}", flush=True)
        return [done[number] for number in sorted(done)]

    rough = seen["roughness"]
    numbers = {number: number for number in range(1, options.cases + 1)}
    cases = weighed("cases", Work(_practised, payload=(options.seed, rough)), numbers)
    every = product(sorted(one.id for one in HARDWARE), _FORMS)
    plans = {number: (number, *one) for number, one in enumerate(islice(every, options.forms), start=1)}
    formed = weighed("forms", Work(_hiding, payload=(options.seed + 2, rough)), plans)
    odd = weighed("odd", Work(_hiding, payload=(options.seed + 3, rough)), _of_kinds(kinds))
    leaves = learn_leaves([*cases, *formed])
    learned = learn([*cases, *odd], Calibration(form=_FORM, leaves=leaves, roughness=rough))
    learned.save(
        options.out,
        cases=len(cases),
        odd=len(odd),
        kinds=kinds,
        bare=options.bare,
        forms=len(plans),
        seed=options.seed,
        loss=round(loss(learned, cases), 4),
        **{name: value for name, value in origin().items() if name != "platform"},
    )
    print(learned)


def _practised(context: tuple[int, Mapping[str, Sequence[float]]], number: int) -> WeighedCase:
    return weigh_simulated(*context, number)


def _hiding(context: tuple[int, Mapping[str, Sequence[float]]], task: tuple[int, str, float]) -> WeighedCase:
    number, name, magnitude = task
    kind = "outside" if name in OUTSIDE else "single"
    return weigh_simulated(*context, number, Plan(kind, ((HIDDEN | OUTSIDE)[name],), magnitude))


def _chosen_kinds(asked: str | None) -> list[str]:
    """Known kinds outside the catalogue for simulated cases, by id.

    Args:
        asked: "all", or a number; None for those of the shipped calibration, so that learning it again gives
            the same result when more are known.
    Raises: OrchestratorError for anything else, and if one of those is not known.
    """
    known = sorted(name for name, kind in OUTSIDE.items() if kind.place not in SOFTWARE)
    if asked is None:
        learned = json.loads(FILE.read_text("utf-8"))["provenance"]["kinds"]
        if strange := sorted(set(learned) - set(known)):
            raise OrchestratorError(
                f"{FILE.name}: learned from {', '.join(strange)}, which the challenge does not know: "
                "--kinds all practises on those that it knows"
            )
        return list(learned)
    if asked == "all":
        return known
    if not asked.isdecimal():
        raise OrchestratorError(f"--kinds: {asked!r}; allowed: all, or 0 to {len(known)}")
    return known[: int(asked)]


def _of_kinds(kinds: Sequence[str]) -> dict[int, tuple[int, str, float]]:
    """Cases of kinds outside the catalogue, from strong to nearly none.

    What a kind's cases are does not depend on which others there are.
    """
    plans = {}
    for name in kinds:
        first = zlib.crc32(name.encode())
        rng = np.random.default_rng(first)
        for time in range(_TIMES):
            share = (time + rng.random()) / _TIMES
            plans[first + time] = (first + time, name, float(_FROM * (_TO / _FROM) ** share))
    return plans


def _outcomes(pool: Pool, work: Work, numbers: Sequence[Any]) -> Iterator[tuple[Any, Any]]:
    """Results of tasks. Raises: OrchestratorError if one failed."""
    for outcome in pool.outcomes(work, numbers):
        if outcome.failure is not None:
            raise OrchestratorError(f"simulated case {outcome.task}: {outcome.failure.message}")
        yield outcome.task, outcome.value


def _written(one: WeighedCase) -> list[Any]:
    """Without answers of two unseen effects, which `_read` adds again."""
    answers = [
        [a.effects, a.gain, a.left, a.ties, a.unseen, a.nonrandom, a.random, a.numerics, a.size, a.parts]
        for a in one.answers
        if len(a.unseen) < 2
    ]
    return [one.truth, one.magnitude, answers, one.beside]


def _read(data: list[Any]) -> WeighedCase:
    truth, magnitude, answers, beside = data
    made = [
        Answer(
            tuple(effects),
            gain,
            left,
            ties=tuple(ties),
            unseen=tuple(unseen),
            nonrandom=nonrandom,
            random=random,
            numerics=numerics,
            size=size,
            parts=tuple(parts),
        )
        for effects, gain, left, ties, unseen, nonrandom, random, numerics, size, parts in answers
    ]
    ids = [one.effects[0] for one in made if len(one.effects) == 1]
    return WeighedCase(tuple(truth), magnitude, tuple(complete(made, ids)), beside)


if __name__ == "__main__":
    # Workers find functions by the name of their module, which for this one is not __main__.
    from tests.benchmarks.rig_calibration import calibrate

    calibrate.main()
