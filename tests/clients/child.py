"""Run jobs in one client: `python -m tests.clients.child CLIENT JOBS.json RESULTS.json`.

Each job is run by a process forked off after the client is imported: a crash in one is reported and harms no
other.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import tempfile
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

from .job import Job
from .masters import CLIENTS, Unable

_SECONDS = 60


def attempt(run: Callable[[Job], dict[str, list[float]]], job: Job) -> dict[str, Any]:
    """Values by output, or why there are none."""
    try:
        return {"values": run(job)}
    except Unable as error:
        return {"unable": str(error)}
    except Exception as error:  # of any tool
        reported = " ".join(str(error).split()) or type(error).__name__
        return {"failed": reported, "trace": traceback.format_exc()}


def isolated(run: Callable[[Job], dict[str, list[float]]], job: Job, file: Path) -> dict[str, Any]:
    """The same in a process of its own."""
    child = os.fork()
    if not child:
        signal.alarm(_SECONDS)
        with tempfile.TemporaryDirectory() as folder:
            os.chdir(folder)  # some clients write logs where they stand
            file.write_text(json.dumps(attempt(run, job)), encoding="utf-8")
            os.chdir("/")
        os._exit(0)  # what a client does at its end is not ours to test
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        return {"failed": f"ends by {signal.Signals(os.WTERMSIG(status)).name}"}
    return json.loads(file.read_text(encoding="utf-8"))


def main(client: str, jobs: str, results: str) -> None:
    """Run all."""
    made = CLIENTS[client]
    made.warm_up()
    out = Path(results)
    found = [
        isolated(made.run, Job.of(one), out.with_suffix(f".{number}"))
        for number, one in enumerate(json.loads(Path(jobs).read_text(encoding="utf-8")))
    ]
    out.write_text(json.dumps(found), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
