"""Jobs given to clients, and what comes out."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from orchestrator.results.recorders import Results

from .job import Job, deviation

__all__ = ["TOLERANCE", "Outcome", "outcomes"]

ROOT = Path(__file__).parents[2]
TOLERANCE = 1e-8  # of a signal's largest value, or of 1e-5 where that is less


@dataclass(frozen=True)
class Outcome:
    """What a client made of a job.

    Attributes:
        deviation: the largest of all signals, relative to the largest value of the signal; None: no values.
        worst: that signal.
        reason: why there are no values.
        unable: whether the tool has no words for the job.
    """

    deviation: float | None
    worst: str = ""
    reason: str = ""
    unable: bool = False

    @property
    def agrees(self) -> bool:
        """Whether the client computes what we do."""
        return self.deviation is not None and self.deviation <= TOLERANCE


def outcomes(client: str, jobs: Sequence[tuple[Job, Results]]) -> list[Outcome]:
    """One for each job; the client runs in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        asked, reported = Path(folder, "jobs.json"), Path(folder, "results.json")
        asked.write_text(json.dumps([job.plain() for job, _ in jobs]), encoding="utf-8")
        command = [sys.executable, "-m", "tests.clients.child", client, str(asked), str(reported)]
        path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
        done = subprocess.run(
            command, cwd=ROOT, env={**os.environ, "PYTHONPATH": path},
            capture_output=True, text=True, timeout=900, check=False,
        )  # fmt: skip
        if done.returncode:
            raise RuntimeError(f"{client} ends with {done.returncode}: {done.stderr[-2000:]}")
        answers = json.loads(reported.read_text(encoding="utf-8"))
    return [_outcome(job, answer, results) for (job, results), answer in zip(jobs, answers, strict=True)]


def _outcome(job: Job, answer: dict, results: Results) -> Outcome:
    if "values" in answer:
        return Outcome(*deviation(job, answer["values"], results))
    return Outcome(None, reason=answer.get("unable") or answer["failed"], unable="unable" in answer)
