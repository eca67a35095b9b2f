"""Learn what a stated probability is worth from the cases of `orchestrator challenge`.

    python tests/benchmarks/blind_calibration.py FOLDER [FOLDER of other seeds]

With the evidence e_i of each answer over the first [nats], p = (1 - q) / sum(exp(e_i / T)). The share q of
laws that are wrong although no rival is near has two values: where the answer leaves little but noise on
held-out runs, and where it leaves more. T and both q are the likeliest on the first folder.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from orchestrator.diagnosis.blind.score import calibration_error

Array = NDArray[np.float64]
# Residual over the noise, above which an answer leaves more than noise.
LEAVES = 1.5


@dataclass(frozen=True)
class Law:
    """A verdict: stated probability, evidence of rivals over it [nats], what it leaves over the noise."""

    stated: float
    odds: Array
    leaves: bool
    right: bool


def laws(folder: Path) -> list[Law]:
    """Verdicts of a folder that name a law."""
    found = []
    for path in sorted(folder.glob("case-*/score.json")):
        score = json.loads(path.read_text(encoding="utf-8"))
        if score.get("verdict") == "law" and score["clear"]:
            verdict = json.loads((path.parent / "verdict.json").read_text(encoding="utf-8"))
            odds = np.array(verdict["odds"], float)
            leaves = score["remains"] > LEAVES
            found.append(Law(float(score["probability"]), odds[odds > -600.0], leaves, bool(score["right"])))
    return found


def tempered(one: Law, temperature: float, explained: float, left: float) -> float:
    """Probability of an answer."""
    rivals = float(np.exp(np.minimum(one.odds / temperature, 50.0)).sum())
    return (1.0 - (left if one.leaves else explained)) / (1.0 + rivals)


def _numbers(theta: Array) -> tuple[float, float, float]:
    first, second = (float(1.0 / (1.0 + np.exp(-one))) for one in theta[1:])
    return float(np.exp(theta[0])), first, second


def main(folders: list[str]) -> None:
    """Print T, both q and the calibration errors."""
    every = [laws(Path(one)) for one in folders]
    hit = np.array([one.right for one in every[0]], bool)
    # Weak priors about T = 3, q = 0.1 and 0.4, since there may be few cases.
    middle = np.array([1.1, -2.2, -0.4])

    def cost(theta: Array) -> float:
        p = np.clip([tempered(one, *_numbers(theta)) for one in every[0]], 1e-6, 1.0 - 1e-6)
        return float(0.25 * ((theta - middle) ** 2).sum() - np.log(np.where(hit, p, 1.0 - p)).sum())

    best = minimize(cost, middle, method="Nelder-Mead", options={"maxiter": 2000})
    found = _numbers(best.x)
    print(f"T = {found[0]:.3g} nats, q = {found[1]:.3g} and {found[2]:.3g}, from {len(hit)} laws")
    for name, some in zip(folders, every, strict=True):
        right = [one.right for one in some]
        before = calibration_error([one.stated for one in some], right)
        after = calibration_error([tempered(one, *found) for one in some], right)
        print(f"{name}: {sum(right)} of {len(some)} laws right; error {before:.3f} before, {after:.3f} after")


if __name__ == "__main__":
    main(sys.argv[1:])
