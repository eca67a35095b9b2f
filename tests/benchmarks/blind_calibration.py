"""Learn what a stated probability is worth from the cases of `orchestrator challenge`.

    python tests/benchmarks/blind_calibration.py FOLDER [FOLDER of other seeds]

With the evidence e_i of each answer over the first [nats], p = (1 - q) / sum(exp(e_i / T)). T and q have the
largest likelihood on the first folder. Calibration errors before and after are those of each folder.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from orchestrator.diagnosis.blind.score import calibration_error

Array = NDArray[np.float64]


def cases(folder: Path) -> list[tuple[float, Array, bool]]:
    """Of each law: stated probability, evidence of rivals over the answer [nats], whether it is right."""
    found = []
    for path in sorted(folder.glob("case-*/score.json")):
        score = json.loads(path.read_text(encoding="utf-8"))
        if score.get("verdict") == "law" and score["clear"]:
            verdict = json.loads((path.parent / "verdict.json").read_text(encoding="utf-8"))
            odds = np.array(verdict["odds"], float)
            found.append((float(score["probability"]), odds[odds > -600.0], bool(score["right"])))
    return found


def tempered(odds: Array, temperature: float, miss: float) -> float:
    """Probability of an answer."""
    return float((1.0 - miss) / (1.0 + np.exp(np.minimum(odds / temperature, 50.0)).sum()))


def main(folders: list[str]) -> None:
    """Print T, q and calibration errors."""
    first, *others = [cases(Path(one)) for one in folders]

    def cost(theta: Array) -> float:
        temperature, miss = float(np.exp(theta[0])), float(1.0 / (1.0 + np.exp(-theta[1])))
        p = np.clip([tempered(odds, temperature, miss) for _, odds, _ in first], 1e-6, 1.0 - 1e-6)
        hit = np.array([right for *_, right in first], bool)
        # A prior of T about 3 and q about 0.1, worth two cases, since there may be few.
        prior = 0.5 * ((theta[0] - 1.0) / 1.5) ** 2 + 0.5 * ((theta[1] + 2.2) / 1.5) ** 2
        return float(-np.log(np.where(hit, p, 1.0 - p)).sum() + prior)

    best = min(
        (minimize(cost, [a, b], method="Nelder-Mead") for a in (0.0, 2.0, 4.0) for b in (-3.0, -1.0)),
        key=lambda one: float(one.fun),
    )
    temperature, miss = float(np.exp(best.x[0])), float(1.0 / (1.0 + np.exp(-best.x[1])))
    print(f"T = {temperature:.3g} nats, q = {miss:.3g}, from {len(first)} laws")
    for name, some in zip(folders, (first, *others), strict=True):
        hit = [right for *_, right in some]
        before = calibration_error([p for p, *_ in some], hit)
        after = calibration_error([tempered(odds, temperature, miss) for _, odds, _ in some], hit)
        print(f"{name}: {len(some)} laws, {sum(hit)} right; error {before:.3f} before, {after:.3f} after")


if __name__ == "__main__":
    main(sys.argv[1:])
