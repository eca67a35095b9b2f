"""Whether the fit of each effect finds the cost that its true parameters allow.

    python -m tests.benchmarks.recovery [EFFECT ...] [--magnitudes 1,0.3,0.1] [--cases N] [--seed S]

Cases are those of the challenge's rig, each with one effect. The fit begins where a search begins it, and
once more at the truth; both costs are printed, and MISS where the first is higher by more than 2.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from orchestrator.diagnosis.rig.answers import REPLAYS
from orchestrator.diagnosis.rig.catalogue import catalogue, of_hardware
from orchestrator.diagnosis.rig.challenge import draw, hidden
from orchestrator.diagnosis.rig.challenge.rig_parameters import CALIBRATED
from orchestrator.diagnosis.rig.fit import Fitter
from orchestrator.diagnosis.rig.model import RigModel
from orchestrator.diagnosis.rig.search import roughness
from orchestrator.diagnosis.rig.study import Role, Study
from tests.benchmarks.rig_calibration.simulated_cases import logged, observed


def fitter_of(study: Study, place: str) -> Fitter:
    """As the weighing makes it for the logs that a place is in."""
    if place in REPLAYS:
        return Fitter(REPLAYS[place](study, study.runs))
    model = RigModel(study, study.runs)
    others = of_hardware()
    return Fitter(model, 1.0, roughness(Fitter(model), others))


def recover(name: str, magnitude: float, seed: int, number: int) -> str:
    """Fit one case, and say how it went in a line."""
    case = draw.draw_case(draw.Plan("single", (hidden.HIDDEN[name],), magnitude), seed, number)
    effect = catalogue()[name]
    truth = list(case.hidden[name].values())[: len(effect.parameters)]
    if name == "robot.command-quantisation":
        truth[1] /= truth[0]
    truth += [one.starts[0] for one in effect.parameters[len(truth) :]]
    fitter = fitter_of(observed(case, logged(case, (Role.TRAIN,))), effect.place)
    count = len(fitter.replay.tolerances)
    none = fitter.fit(())
    bases = [fitter.base((), np.zeros(count)), fitter.base((), none.z)]
    plain = {one: case.plain[knob] for one, knob in CALIBRATED.items()}
    z = fitter.normalised(plain, (effect,), np.array(truth))
    true = fitter.fit((effect,), z[:count], z[count:])
    _, base, start = fitter.screen(effect, bases)
    fit = fitter.fit((effect,), base.z, start, base.jacobian)
    found = "MISS" if fit.cost > true.cost + 2.0 else "ok  "
    costs = f"none {none.cost:.0f}  truth {true.cost:.0f}  search {fit.cost:.0f}"
    return f"{found} {name:28s} {magnitude:4.2f}  {costs}  true {truth}  found {fit.theta.tolist()}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw, fit and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("effects", nargs="*")
    parser.add_argument("--magnitudes", default="1,0.3,0.1")
    parser.add_argument("--cases", type=int, default=1)
    parser.add_argument("--seed", type=int, default=777)
    options = parser.parse_args(arguments)
    names = options.effects or [one.id for one in catalogue().values() if not one.statistic]
    with threadpool_limits(limits=1, user_api="blas"):
        for name in names:
            for magnitude in map(float, options.magnitudes.split(",")):
                for number in range(1, options.cases + 1):
                    print(recover(name, magnitude, options.seed, number), flush=True)


if __name__ == "__main__":
    main()
