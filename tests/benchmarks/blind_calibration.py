"""Learn what a stated probability is worth from the cases of `orchestrator challenge`.

    python tests/benchmarks/blind_calibration.py FOLDER [FOLDER of other seeds]

With the evidence e_i of each rival over the answer [nats], p = (1 - q) / (1 + r sum(w_i exp(e_i / T))). The
weight w_i is a tenth for a rival that is less likely before the logs are seen, else 1. The share q of laws
that are wrong although no rival is near has two values: where the answer leaves little but noise on held-out
runs, and where it leaves more. T, r and both q are the likeliest on the first folder. The counts are of all
folders.
"""

from __future__ import annotations

import json
import sys
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from orchestrator.diagnosis.blind.score import calibration_error

Array = NDArray[np.float64]
# Residual over the noise, above which an answer leaves more than noise.
LEAVES = 1.2


@dataclass(frozen=True)
class Verdict:
    """What is stated: kind, probability, rivals, whether it leaves more than noise.

    Attributes:
        rivals: evidence over it [nats] and weight of each, shape (n, 2).
    """

    kind: str
    stated: float
    rivals: Array
    leaves: bool
    right: bool
    clear: bool


def _kind(score: Mapping[str, Any], verdict: Mapping[str, Any]) -> str:
    if score["verdict"] == "outside":
        refused = any("contradict the nearest law" in one for one in verdict["remarks"])
        return "outside, a law contradicted" if refused else "outside"
    return f"{score['verdict']}, {'more than noise' if score['remains'] > LEAVES else 'noise'} left"


def verdicts(folder: Path) -> list[Verdict]:
    """Of a folder."""
    found = []
    for path in sorted(folder.glob("case-*/score.json")):
        score = json.loads(path.read_text(encoding="utf-8"))
        if score.get("verdict", "error") == "error":
            continue
        verdict = json.loads((path.parent / "verdict.json").read_text(encoding="utf-8"))
        leaves = score["remains"] > LEAVES
        rivals = np.array(verdict["evidence"], float).reshape(-1, 2)
        kind, stated = _kind(score, verdict), float(score["probability"])
        right, clear = bool(score["right"]), bool(score["clear"])
        found.append(Verdict(kind, stated, rivals, leaves, right, clear))
    return found


def tempered(one: Verdict, temperature: float, weight: float, explained: float, left: float) -> float:
    """Probability of a law."""
    nats, weights = one.rivals.T
    rivals = weight * float((weights * np.exp(np.minimum(nats / temperature, 50.0))).sum())
    return (1.0 - (left if one.leaves else explained)) / (1.0 + rivals)


def _numbers(theta: Array) -> tuple[float, float, float, float]:
    first, second = (float(1.0 / (1.0 + np.exp(-one))) for one in theta[2:])
    return float(np.exp(theta[0])), float(np.exp(theta[1])), first, second


def main(folders: list[str]) -> None:
    """Print T, r, both q, calibration errors, and how many verdicts of each kind were right."""
    every = [verdicts(Path(one)) for one in folders]
    laws = [[one for one in some if one.clear and one.kind.startswith("law")] for some in every]
    hit = np.array([one.right for one in laws[0]], bool)
    # Weak priors about T = 1.1, r = 0.6, q = 0.05 and 0.4, since there may be few cases.
    middle = np.array([0.1, -0.5, -3.0, -0.4])

    def cost(theta: Array) -> float:
        p = np.clip([tempered(one, *_numbers(theta)) for one in laws[0]], 1e-6, 1.0 - 1e-6)
        return float(0.25 * ((theta - middle) ** 2).sum() - np.log(np.where(hit, p, 1.0 - p)).sum())

    best = minimize(cost, middle, method="Nelder-Mead", options={"maxiter": 2000})
    found = _numbers(best.x)
    numbers = "T = {:.3g} nats, r = {:.2g}, q = {:.3g} and {:.3g}".format(*found)
    print(f"{numbers}, from {len(hit)} laws")
    for name, some, alone in zip(folders, every, laws, strict=True):
        errors = [
            calibration_error([one.stated for one in part], [one.right for one in part])
            for part in (some, [one for one in some if not one.kind.startswith("outside")], alone)
        ]
        after = calibration_error([tempered(one, *found) for one in alone], [one.right for one in alone])
        print(f"{name}: error {errors[0]:.3f} of {len(some)} verdicts, {errors[1]:.3f} but for outside; "
              f"of {len(alone)} laws {errors[2]:.3f}, {after:.3f} with these numbers")  # fmt: skip
    counts: dict[tuple[str, str], list[bool]] = defaultdict(list)
    for one in (one for some in every for one in some):
        counts[one.kind, f"{10 * int(10 * min(one.stated, 0.99)):3} %"].append(one.right)
    for (kind, stated), right in sorted(counts.items()):
        print(f"{kind:32} stated from {stated}: {sum(right)} of {len(right)} right")


if __name__ == "__main__":
    main(sys.argv[1:])
