"""How a diagnosis does on the simulated cases that it learned from, each fifth by what the others teach.

    python -m orchestrator.diagnosis.calibrate --seen cases.json --out /dev/null
    python -m tests.benchmarks.cross_validation cases.json

The first command weighs the cases, in about 40 minutes on two cores; the second learns all of the map from
evidence to probabilities anew in each fold, but for the roughness and the cases of one clear effect each,
which are others.
"""

from __future__ import annotations

import argparse
import json
import math
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple, cast

from orchestrator.diagnosis.answers import Group
from orchestrator.diagnosis.calibrate import _FORM, Practice, _read, learn, learn_leaves
from orchestrator.diagnosis.calibration import Calibration
from orchestrator.diagnosis.challenge.hidden import HARDWARE, HIDDEN
from orchestrator.diagnosis.challenge.score import BANDS, _ece, _ece_exact, band
from orchestrator.diagnosis.challenge.verdict import names
from orchestrator.diagnosis.finding import name_of
from orchestrator.diagnosis.fit import Fit
from orchestrator.diagnosis.weigh import conclude

_FOLDS = 5


class Told(NamedTuple):
    """What a diagnosis told of a case: whether its verdict names the truth, and its set holds it."""

    case: Practice
    effects: tuple[str, ...]
    right: bool
    covered: bool
    confidence: float
    first_right: bool


def of_hardware_alone(learned: Calibration) -> Calibration:
    """What was learned, for cases that hide no effects of the software: see `calibrate._of_all`."""
    more = math.log(len(HARDWARE) / len(HIDDEN))
    return replace(learned, hidden=learned.hidden + more, beside=learned.beside + more)


def told(case: Practice, learned: Calibration) -> Told:
    """Weigh a practised case by what was learned of others."""
    place = "contact"
    none = cast(Fit, SimpleNamespace(calibrated={}))
    found = conclude([Group(case.answers, case.beside, place, none)], learned)
    truth = case.truth
    fitting = {name_of(one.effects) for one in found.candidates if names(one.effects, one.ties, truth)}
    first = found.candidates[0]
    alike = [one for one in found.candidates if names(first.effects, first.ties, one.effects)]
    confidence = sum(one.probability for one in alike)
    return Told(
        case,
        found.effects,
        name_of(tuple(sorted(found.effects))) in fitting,
        any(name in fitting for name in found.answer_set),
        min(confidence, 1.0),
        name_of(first.effects) in fitting,
    )


def main() -> None:
    """Learn in each fold from the others, and print how it did."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("seen", type=Path, help="what `calibrate --seen` kept")
    seen = json.loads(parser.parse_args().seen.read_text(encoding="utf-8"))
    cases, formed = (
        [_read(data) for _, data in sorted(seen[kind].items(), key=lambda one: int(one[0]))]
        for kind in ("cases", "forms")
    )
    every: list[Told] = []
    for fold in range(_FOLDS):
        others = [one for at, one in enumerate(cases) if at % _FOLDS != fold]
        start = Calibration(form=_FORM, leaves=learn_leaves([*others, *formed]), roughness=seen["roughness"])
        learned = of_hardware_alone(learn(others, start))
        every += [told(one, learned) for one in cases[fold::_FOLDS]]
    hidden = [one for one in every if one.case.truth]
    for name, _ in BANDS:
        here = [one for one in hidden if band(one.case.magnitude) == name]
        print(f"{name + ', sets that hold the truth':<40} {sum(one.covered for one in here)}/{len(here)}")
    print(f"{'sets that hold the truth':<40} {sum(one.covered for one in every)}/{len(every)}")
    bare = [one for one in every if not one.case.truth]
    print(f"{'nothing hidden, and yet blamed':<40} {sum(bool(one.effects) for one in bare)}/{len(bare)}")
    for outside in (True, False):
        some = [one for one in every if (one.case.truth == ("outside",)) == outside]
        count = sum(one.effects == ("outside",) for one in some)
        title = "outside the catalogue, and told so" if outside else "not outside, and told so"
        print(f"{title:<40} {count}/{len(some)}")
    kinds = Counter(one.case.kind for one in every)
    for kind in ("single", "pair"):
        count = sum(one.right for one in every if one.case.kind == kind)
        print(f"{kind + ', named, clear or not':<40} {count}/{kinds[kind]}")
    exact = _ece_exact([one.confidence for one in every])
    assert exact is not None
    error = _ece([(one.confidence, one.first_right) for one in every])
    print(f"{'calibration error':<40} {error:.3f} (exact probabilities: {exact['mean']:.3f})")


if __name__ == "__main__":
    main()
