"""A diagnosis in a few lines, for a terminal."""

from __future__ import annotations

from .caveats import caveats
from .diagnosed import Diagnosed
from .headline import SEPARATES, headline, leaves_in_words, nats, percent

_LINES = 4

# Printed where no simulated experiment would separate the likely answers.
UNTOLD = (
    "no experiment that was considered separates these answers; name what else can be run under "
    "`experiments` of the study"
)


def text(made: Diagnosed) -> str:
    """What a command prints of a case."""
    found = made.diagnosis
    lines = [f"{found.case}: {headline(found)}", *(f"  {one}" for one in caveats(found))]
    for one in found.which[:_LINES]:
        ties = f" (tied with {', '.join(one.ties)})" if one.ties else ""
        lines.append(f"  {percent(one.probability):>12}  {' + '.join(one.effects) or 'no effect'}{ties}")
    # Where nothing is in excess, shares are those of noise.
    if found.where and (found.verdict.effects or found.doubtful_tolerances):
        shares = ", ".join(
            f"{one.place} {percent(one.share)}" for one in found.where if abs(one.share) >= 0.0005
        )
        lines.append(f"  where: {shares}")
    if found.next_experiment is not None:
        evidence = found.next_experiment.expected_evidence
        expected = "" if evidence is None else f" ({nats(evidence)} expected)"
        if evidence is not None and evidence < SEPARATES:
            lines.append(f"  next: {UNTOLD}")
        else:
            lines.append(f"  next: {found.next_experiment.name}{expected}")
            if found.next_experiment.leaves:
                lines.append(f"        {leaves_in_words(found.next_experiment)}")
    for one in found.data:
        lines += [f"  data: {one.place}: {one.what}", *([f"        {one.remedy}"] if one.remedy else [])]
    lines += [f"  left out: {name.replace('_', ' ')}: {why}" for name, why in found.left_out.items()]
    if made.folder is not None:
        lines.append(f"  written to {made.folder}: {', '.join(made.files)}")
    return "\n".join(lines)
