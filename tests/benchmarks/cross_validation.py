"""How a diagnosis does on the simulated cases that it learned from, each fifth by what the others teach.

    python -m tests.benchmarks.rig_calibration.calibrate --seen cases.json --out /dev/null
    python -m tests.benchmarks.cross_validation cases.json

The first command weighs the cases, in about an hour on two cores; the second learns all of the map from
evidence to probabilities anew in each fold, but for the roughness and the cases of one clear effect each,
which are others. Of the challenge's known kinds outside the catalogue all cases of a kind are in one fold: it
is recognised by what other kinds teach.
"""

from __future__ import annotations

import argparse
import json
import math
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

from orchestrator.diagnosis.rig.answers import Group
from orchestrator.diagnosis.rig.calibration import Calibration
from orchestrator.diagnosis.rig.challenge.hidden import HARDWARE, HIDDEN
from orchestrator.diagnosis.rig.challenge.score import BANDS, Marked, _ece, _ece_exact, band
from orchestrator.diagnosis.rig.challenge.verdict import Answer, Verdict, answer_set
from orchestrator.diagnosis.rig.fit import Fit
from orchestrator.diagnosis.rig.weigh import conclude
from tests.benchmarks.rig_calibration.calibrate import _FORM, _chosen_kinds, _of_kinds, _read
from tests.benchmarks.rig_calibration.learning import WeighedCase, learn, learn_leaves

_FOLDS = 5


def of_hardware_alone(learned: Calibration) -> Calibration:
    """What was learned, for cases that hide no effects of the software: see `learning._of_all`."""
    more = math.log(len(HARDWARE) / len(HIDDEN))
    return replace(learned, hidden=learned.hidden + more, beside=learned.beside + more)


def marked(case: WeighedCase, learned: Calibration) -> Marked:
    """A practised case, weighed by what was learned of others."""
    none = cast(Fit, SimpleNamespace(calibrated={}))
    found = conclude([Group(case.answers, case.beside, "contact", none)], learned)
    effects = frozenset(found.effects)
    answers = tuple(
        Answer(frozenset(one.effects), one.probability, frozenset(one.ties)) for one in found.candidates
    )
    ties = next((one.ties for one in answers if one.effects == effects), frozenset())
    given = answer_set(answers, found.answer_set)
    verdict = Verdict(effects, frozenset(found.places), ties, answers, None, None, False, given, "")
    truth = {"kind": case.kind, "magnitude": case.magnitude, "effects": sorted(case.truth)}
    return Marked("", truth, verdict)


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
    practised = _of_kinds(_chosen_kinds("all")).values()
    kept = [(name, str(number)) for number, name, _ in practised if str(number) in seen["odd"]]
    names = sorted({name for name, _ in kept})
    odd: list[list[WeighedCase]] = [[] for _ in range(_FOLDS)]
    for name, number in kept:
        odd[names.index(name) % _FOLDS].append(_read(seen["odd"][number]))
    every: list[Marked] = []
    strange: list[Marked] = []
    for fold in range(_FOLDS):
        others = [one for at, one in enumerate(cases) if at % _FOLDS != fold]
        stranger = [one for at, some in enumerate(odd) if at != fold for one in some]
        start = Calibration(form=_FORM, leaves=learn_leaves([*others, *formed]), roughness=seen["roughness"])
        learned = of_hardware_alone(learn([*others, *stranger], start))
        every += [marked(one, learned) for one in cases[fold::_FOLDS]]
        strange += [marked(one, learned) for one in odd[fold]]
    hidden = [one for one in every if one.kind != "none"]
    for name, _ in BANDS:
        here = [one for one in hidden if band(one.truth["magnitude"]) == name]
        held = sum(one.named_by(one.verdict.answer_set) for one in here)
        print(f"{name + ', sets that hold the truth':<40} {held}/{len(here)}")
    held = sum(one.named_by(one.verdict.answer_set) for one in every)
    print(f"{'sets that hold the truth':<40} {held}/{len(every)}")
    bare = [one for one in every if one.kind == "none"]
    print(
        f"{'nothing hidden, and yet blamed':<40} {sum(bool(one.verdict.effects) for one in bare)}/{len(bare)}"
    )
    for outside in (True, False):
        some = [one for one in every if (one.kind == "outside") == outside]
        count = sum("outside" in one.verdict.effects for one in some)
        title = "outside the catalogue, and reported so" if outside else "not outside, and reported so"
        print(f"{title:<40} {count}/{len(some)}")
    for name, _ in (("all", 0.0), *BANDS):
        here = [one for one in strange if name in ("all", band(one.truth["magnitude"]))]
        count = sum("outside" in one.verdict.effects for one in here)
        print(f"{'known kinds outside, reported so: ' + name:<40} {count}/{len(here)}")
    kinds = Counter(one.kind for one in every)
    for kind in ("single", "pair"):
        count = sum(one.effect_right for one in every if one.kind == kind)
        print(f"{kind + ', named, clear or not':<40} {count}/{kinds[kind]}")
    for name in ("all", "none", *(name for name, _ in BANDS)):
        here = [one for one in every if name in ("all", _band(one))]
        exact = _ece_exact([one.confidence for one in here])
        assert exact is not None
        error = _ece([(one.confidence, one.first_right) for one in here])
        claimed, right = (
            sum(some) / len(here)
            for some in ([one.confidence for one in here], [one.first_right for one in here])
        )
        reported = f"{error:.3f} (exact probabilities: {exact['mean']:.3f})"
        print(f"{'calibration error, ' + name:<40} {reported}; claimed {claimed:.2f}, right {right:.2f}")


def _band(one: Marked) -> str:
    """Of its magnitude; "none" where nothing is hidden."""
    return "none" if one.kind == "none" else band(one.truth["magnitude"])


if __name__ == "__main__":
    main()
