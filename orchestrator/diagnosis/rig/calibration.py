"""Map from evidence to probabilities, learned from simulated cases."""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from itertools import chain, combinations
from pathlib import Path

import numpy as np
from scipy.special import logsumexp

from .answers import Answer
from .residual_evidence import ResidualEvidence
from .study import Array

# Log evidence of more is none of an effect's form: the model without it ran away [nats].
_RUNAWAY = 1e6
# Of an effect on which nothing was learned, see `Calibration.leaves`.
LEAVES = 0.003
# Probability that a set of answers holds.
SET = 0.95
# If halving the sub-steps changes a replay, its error is larger than the change: up to three times more on
# rigs at a servo's limit.
_REPLAY_ERROR = 4.0
# Size at which many an effect shows and many do not, see `strength`.
_ORDINARY = 0.2
# Where the learning of `Calibration.slopes` begins.
_SLOPE = 0.35
# Of ln(1 + u), see `Calibration`: what right answers hardly ever leave.
_FAR = 2.5
# What comes with the product.
FILE = Path(__file__).parent / "calibration.json"


@dataclass(frozen=True)
class Table:
    """Answers of a group as arrays; see `Calibration.table`.

    Attributes:
        gain, left, nonrandom: see `answers.Answer`; formed: the gain without that of random effects.
        whole: residual evidence without parts [nats].
        seen, unseen: number of effects with evidence in the logs, and without.
        replay_error: part of the residual evidence that the replay's own error may cause [nats].
        usual: see `Calibration.usual`; rarity: see `Calibration.rarity`.
        strength: see `strength`.
            Each of shape (answers,), or (groups, answers).
        excess: ln(1 + u) of each part of the residual evidence, shape (answers, parts), or (groups, answers,
            parts).
    """

    gain: Array
    formed: Array
    left: Array
    whole: Array
    nonrandom: Array
    replay_error: Array
    usual: Array
    seen: Array
    unseen: Array
    strength: Array
    rarity: Array
    excess: Array


@dataclass(frozen=True)
class Calibration:
    """Map from log evidences to probabilities.

    The score of an answer is its log evidence over T = temperature + growth b^`power` + form w. b is the log
    evidence of the best answer, without that of random effects. w is the residual evidence that the best
    answer usually leaves (see `usual`), or the one that it does leave if that is less, scaled by b over its
    log evidence. The reason: the form of a real effect differs a little from the catalogue's, and a second
    effect that corrects this is no evidence. The replay's own error (see `Table`) counts as usual.

    Prices are subtracted. An effect with evidence costs `first`, the second one `second`, each further one
    `further`. An effect that is too small to be seen costs `hidden`. Beside another one it costs `beside` and
    `fainter` times its `strength`, since the effects of one rig have similar sizes; as a third one,
    `further`. It costs more if it is seldom unseen.

    Something outside the catalogue has the score of the best answer of its group, minus `outside`, plus the
    evidence against the answers: `slopes` times ln(1 + u), with u each part of the residual evidence over the
    usual one; `slope` times the same for residuals without parts and for those that no answer could explain;
    `beyond` times the excess of the largest over right answers; the log likelihood that effects taken for
    random are not; `several` for a second effect with evidence, and `many` for each further one, since
    combinations often imitate other effects. The odds of outside over the answers are averaged harmonically,
    weighted by the answers' probabilities: one likely answer without such evidence contradicts outside. A
    share `floor` of the probability is spread evenly.

    A set of answers holds 95 % of the probability, or more, so that faint effects are in 95 of 100 sets as
    well: `sure` without evidence for an effect, `surely` with evidence for one, which may hide another.

    Attributes:
        unseen: of the effects that stay unseen, how many are which, by id; they add up to one.
        slopes: of the parts of what answers leave, see `held_out.UnexplainedEvidence`.
        leaves: share of its log evidence that an effect usually leaves unexplained, by id, since its form on
            rigs is not quite the catalogue's.
        roughness: of rigs that hide nothing, standard deviations as shares of an effect's prior, by id, one
            per start of its shape.
    """

    temperature: float = 1.5
    growth: float = 0.05
    power: float = 0.5
    form: float = 0.0
    first: float = 4.0
    second: float = 5.0
    further: float = 8.0
    hidden: float = 1.5
    beside: float = 2.0
    fainter: float = 1.0
    outside: float = 8.0
    slope: float = 1.5
    beyond: float = 1.0
    several: float = 1.0
    many: float = 2.0
    sure: float = 0.95
    surely: float = 0.95
    floor: float = 0.002
    slopes: tuple[float, ...] = (_SLOPE,) * (2 * len(ResidualEvidence._fields))
    unseen: Mapping[str, float] = field(default_factory=dict)
    leaves: Mapping[str, float] = field(default_factory=dict)
    roughness: Mapping[str, Sequence[float]] = field(default_factory=dict)

    def price(
        self,
        seen: int | Array,
        unseen: int | Array = 0,
        rarity: float | Array = 0.0,
        strong: float | Array = 0.0,
    ) -> float | Array:
        """Prices of effects in all groups of logs together: beyond two, each `further`, seen or not.

        Args:
            seen, unseen: number of effects with evidence, and of those that are too small to have any.
            rarity: of the latter, see `rarity`; strong: of the former, see `strength`; all of one shape.
        """
        cost = self.first * np.minimum(seen, 1) + self.second * np.clip(np.subtract(seen, 1), 0, 1)
        cost = cost + self.further * np.maximum(np.subtract(seen, 2), 0)
        few = np.minimum(unseen, np.maximum(np.subtract(2, seen), 0))
        other = self.beside + self.fainter * np.asarray(strong)
        alone = np.where(np.equal(seen, 0), self.hidden, other) * np.minimum(few, 1)
        cost = cost + alone + self.beside * np.maximum(few - 1, 0)
        return cost + self.further * np.subtract(unseen, few) + rarity

    def rarity(self, unseen: Collection[str]) -> float:
        """Log rarity of these effects among unseen ones [nats]."""
        usual = 1.0 / max(len(self.unseen), 1)
        return -sum(math.log(self.unseen.get(name, usual)) for name in unseen)

    def usual(self, answers: Sequence[Answer]) -> Array:
        """Usual residual evidence of answers as good as these [nats], shape (answers,).

        Of several effects each may leave its share of what it gains itself: one that gains little accounts
        for little, whatever the others gain.
        """

        def left(name: str, own: float) -> float:
            # A replay that runs away without an effect deviates in proportion with it; software has its exact
            # form.
            return self.leaves[name] * own if name in self.leaves else LEAVES * min(own, _RUNAWAY)

        return np.array(
            [1.0 + max((left(*own) for own in gained.items()), default=0.0) for gained in own_gains(answers)]
        )

    def table(self, answers: Sequence[Answer]) -> Table:
        """Quantities from which scores are computed."""
        unseen = np.array([len(one.unseen) for one in answers])
        left = np.array([one.left for one in answers])
        # By no more than an effect explains: an imitation that swings up explains nothing.
        replay_error = _REPLAY_ERROR * np.array([min(one.numerics, max(one.gain, 0.0)) for one in answers])
        usual = self.usual(answers)
        none = (0.0,) * len(self.slopes)
        parts = np.array([one.parts or none for one in answers])
        # The replay's own error is in all parts.
        share = np.divide(replay_error, left, out=np.zeros(len(left)), where=left > 0.0)
        return Table(
            np.array([one.gain for one in answers]),
            np.array([one.gain - one.random for one in answers]),
            left,
            np.array([0.0 if one.parts else one.left for one in answers]),
            np.array([one.nonrandom for one in answers]),
            replay_error,
            usual,
            np.array([len(one.effects) for one in answers]) - unseen,
            unseen,
            np.array([strength(one.size) for one in answers]),
            np.array([self.rarity(one.unseen) for one in answers]),
            np.log1p(parts * (np.maximum(1.0 - share, 0.0) / usual)[:, None]),
        )

    def scores(self, answers: Sequence[Answer] | Table, beside: float | Array) -> tuple[Array, Array]:
        """Scores of a group's answers and, last, of something outside the catalogue.

        Args:
            answers: none first.
            beside: log evidence of something outside that no answer could explain [nats].
        Returns: scores, and the prices that they are still to be lessened by where the group stands alone.
            That of outside is zero: it has paid for the answer that it stands beside; each of shape
            (answers + 1,), and where a table is of several groups, so many of them.
        """
        of = answers if isinstance(answers, Table) else self.table(answers)
        at = np.argmax(of.gain, -1, keepdims=True)
        most, best, usual, left, replay_error = (
            np.take_along_axis(one, at, -1)
            for one in (of.gain, of.formed, of.usual, of.left, of.replay_error)
        )
        best = np.maximum(best, 0.0)
        lacking = np.minimum(usual - 1.0 + replay_error, np.maximum(left, 1.0))
        form = self.form * lacking * best / np.maximum(np.maximum(most, best), 1.0)
        scores = of.gain / (self.temperature + self.growth * best**self.power + form)
        prices = self.price(of.seen, of.unseen, of.rarity, of.strength)
        priced = np.where(of.unseen > 0, -np.inf, scores - prices)
        top = priced.max(-1, keepdims=True)
        more = of.seen - 1.0
        # Much stays unexplained of a strong effect whose form is not quite the textbook's.
        u = np.maximum(of.whole - of.replay_error, 0.0) + np.expand_dims(beside, -1)
        excess = of.excess @ np.asarray(self.slopes) + self.beyond * np.maximum(of.excess.max(-1) - _FAR, 0.0)
        excess = excess + self.slope * np.log1p(u / of.usual) + of.nonrandom
        excess = excess + self.several * np.clip(more, 0.0, 1.0) + self.many * np.maximum(more - 1.0, 0.0)
        outside = logsumexp(priced, -1, keepdims=True) - logsumexp(priced - excess, -1, keepdims=True)
        outside = outside + top - self.outside
        return np.concatenate([scores, outside], -1), np.concatenate([prices, np.zeros_like(outside)], -1)

    def probabilities(self, answers: Sequence[Answer] | Table, beside: float | Array) -> Array:
        """Probabilities of the answers of a single group and, last, of something outside."""
        scores, prices = self.scores(answers, beside)
        return self.spread(scores - prices)

    def spread(self, scores: Array, alike: float | Array = 1.0) -> Array:
        """Probabilities from scores, prices taken off.

        Args:
            alike: number of answers with each score.
        """
        p = np.exp(scores - scores.max(-1, keepdims=True))
        p /= p.sum(-1, keepdims=True)
        even = np.broadcast_to(alike, p.shape)
        return (1.0 - self.floor) * p + self.floor * even / even.sum(-1, keepdims=True)

    def enough(self, seen: bool) -> float:
        """Probability that a set of answers holds, with evidence for an effect, or for none."""
        return max(self.surely if seen else self.sure, SET)

    def save(self, path: Path = FILE, **provenance: object) -> None:
        """Write the learned numbers and their origin."""
        text = json.dumps({"format": "weigh/16", **asdict(self), "provenance": provenance}, indent=1)
        path.write_text(text + "\n", encoding="utf-8")


def strength(size: float) -> float:
    """Logarithmic size of an effect above sizes with little evidence; near 0 below them.

    Args:
        size: see `Effect.size`; 0, an unknown one, is ordinary.
    """
    return math.log1p(((size or _ORDINARY) / _ORDINARY) ** 2)


def own_gains(answers: Sequence[Answer]) -> list[dict[str, float]]:
    """Gain of each effect with evidence beside the others [nats], by id; one mapping per answer.

    That is the answer's log evidence over the best answer with none but the others.
    """
    gains = {frozenset(one.effects): one.gain for one in answers if not one.unseen}

    def own(one: Answer, name: str) -> float:
        others = [other for other in one.seen if other != name]
        fewer = chain.from_iterable(combinations(others, size) for size in range(len(one.seen)))
        return max(one.gain - max(gains.get(frozenset(some), 0.0) for some in fewer), 0.0)

    return [{name: own(one, name) for name in one.seen} for one in answers]


@lru_cache(maxsize=1)
def calibration() -> Calibration:
    """The shipped calibration; `python -m tests.benchmarks.rig_calibration.calibrate` learns it again."""
    data = json.loads(FILE.read_text(encoding="utf-8"))
    return Calibration(**{name: data[name] for name in Calibration.__dataclass_fields__})
