"""Whether the experiment that a diagnosis proposes breaks the ties that it declares.

    python -m tests.benchmarks.ties [--cases N] [--seed S] [EFFECT ...]

Cases are those of the challenge's rig, each with one effect that others look like. Where a diagnosis declares
ties, or says that another single effect is probable, and the hidden effect is among them, the experiment it
proposes is simulated with the hidden effect as fitted, and with noise; then each candidate is fitted to old
and new logs together. The tie is broken where the hidden one has 10 nats more than every other that still
does something: one that explains both no better than none does, while the hidden one does, is out, too. Then
what remains beside the hidden effect is a calibration that strays, as after dead weights and a tip tracker a
contact that is stiffer than it was calibrated.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import binomtest
from threadpoolctl import threadpool_limits

from orchestrator.diagnosis.rig.catalogue import catalogue
from orchestrator.diagnosis.rig.challenge import draw, hidden
from orchestrator.diagnosis.rig.challenge.hidden import between
from orchestrator.diagnosis.rig.experiments import _tied, next_experiment
from orchestrator.diagnosis.rig.fit import Fitter
from orchestrator.diagnosis.rig.menu import menu
from orchestrator.diagnosis.rig.predicted_runs import Chain, Trial
from orchestrator.diagnosis.rig.study import Role, Study
from orchestrator.diagnosis.rig.weigh import weigh
from tests.benchmarks.rig_calibration.simulated_cases import logged, observed
from tests.diagnosis.labs import Noisy

_ALIKE = (
    "sensor.gain", "contact.stiffness", "structure.compliance", "sensor.delay", "sensor.low-pass",
    "contact.damping", "robot.delay", "robot.bandwidth", "robot.damping", "dynamics.mass",
    "dynamics.mass-offset", "structure.offset", "contact.wall-offset", "structure.kinematic-scale",
)  # fmt: skip
_BROKEN, _NOTHING = 10.0, 1.0  # nats


class Told(NamedTuple):
    """What became of a tie.

    Attributes:
        experiment: that was proposed.
        lead: of the truth over every rival and none after it [nats]; alone: whether no rival does anything.
    """

    experiment: str
    lead: float
    alone: bool

    @property
    def broken(self) -> bool:
        """Whether the truth is distinguished from every rival."""
        return self.lead >= (_NOTHING if self.alone else _BROKEN)


def broken(study: Study, truth: str, seed: int) -> Told | None:
    """What becomes of a tie with the truth by the experiment proposed; None where nothing is tied."""
    found = weigh(study)
    tied = {name: model for name, model in _tied(study, found).items() if len(model.effects) == 1}
    if truth not in tied or len(tied) < 2 or found.effects not in [(name,) for name in tied]:
        return None
    reported = next_experiment(study, found)
    assert reported is not None
    experiment = next(one for one in menu() if one.name == reported["name"])
    effects = [catalogue()[name] for name in tied]
    trial = Trial(study, experiment, tied[truth], effects)
    costs = {}
    for name, model in {**tied, "none": found.recalibrated}.items():
        chain = Chain((Chain.of(study, study.of(Role.TRAIN), model.effects), Noisy(trial, seed)))
        fitter = Fitter(chain)
        count = len(fitter.replay.tolerances)
        z = fitter.normalised(model.calibrated, model.effects, model.theta)
        starts = [start for effect in model.effects for start in fitter.starts(effect)]
        begins = [(z[:count], z[count:]), *((None, start) for start in (z[count:], *starts))]
        costs[name] = min(fitter.fit(model.effects, *begin).cost for begin in begins)
    gains = {name: 0.5 * (costs["none"] - costs[name]) for name in tied}
    most = max(gain for name, gain in gains.items() if name != truth)
    return Told(reported["name"], gains[truth] - max(most, 0.0), most < _NOTHING)


def main(arguments: Sequence[str] | None = None) -> None:
    """Make cases, diagnose, experiment, and print how many ties are broken."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("effects", nargs="*", default=list(_ALIKE))
    parser.add_argument("--cases", type=int, default=56)
    parser.add_argument("--seed", type=int, default=71)
    options = parser.parse_args(arguments)
    found: list[Told] = []
    with threadpool_limits(limits=1, user_api="blas"):
        for number in range(1, options.cases + 1):
            truth = options.effects[(number - 1) % len(options.effects)]
            magnitude = between(np.random.default_rng([options.seed, number]), 0.1, 1.2)
            plan = draw.Plan("single", (hidden.HIDDEN[truth],), magnitude)
            case = draw.draw_case(plan, options.seed, number)
            study = observed(case, logged(case, (Role.TRAIN,)))
            reported = broken(study, truth, number)
            if reported is None:
                print(f"{number:3d} {truth:<26} {magnitude:.2f}  no tie with it", flush=True)
                continue
            found.append(reported)
            more = "; no rival does anything" if reported.alone else ""
            shown = f"leads by {reported.lead:.1f} nats{more}"
            print(f"{number:3d} {truth:<26} {magnitude:.2f}  {reported.experiment:<30} {shown}", flush=True)
    count = sum(one.broken for one in found)
    if found:
        low, high = binomtest(count, len(found)).proportion_ci(method="wilson")
        print(f"{count} of {len(found)} ties broken ({low:.2f} to {high:.2f})")


if __name__ == "__main__":
    main()
