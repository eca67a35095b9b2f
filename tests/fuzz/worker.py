"""Runs commands in one process after each other, as orders on the standard input tell.

An order is a JSON object in one line, with `arguments`, `folder`, `output` (a file) and `stop` (a stage of a
diagnosis, or null). The answer tells the status, seconds of processor time, growth of the largest memory
[B], and the files outside of `room` that were opened for writing.
"""

from __future__ import annotations

import json
import os
import resource
import sys
import traceback
from pathlib import Path
from typing import Any

# More than any input may take, and less than what harms the machine.
MOST_ADDRESSES = 6 * 2**30
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT


class Enough(Exception):
    """A diagnosis has read its input."""


def watch(room: str, found: list[str]) -> None:
    """Note files outside of a folder that Python writes."""
    allowed = (room, "/dev/", os.environ["NUMBA_CACHE_DIR"])

    def hook(event: str, given: tuple[Any, ...]) -> None:
        if event == "open":
            path = given[0] if len(given) > 2 and isinstance(given[2], int) and given[2] & _WRITING else None
        elif event in ("os.mkdir", "os.remove", "os.rmdir", "os.truncate"):
            path = given[0]
        elif event in ("os.rename", "os.link", "os.symlink"):
            path = given[1]
        else:
            return
        if isinstance(path, str | bytes | os.PathLike):
            name = os.fsdecode(path)
            # Relative to the folder of the command, unless the call gave another as a file descriptor.
            full = os.path.realpath(os.path.dirname(os.path.abspath(name)))
            relative = event in ("os.remove", "os.rmdir") and not os.path.isabs(name)
            if not relative and not f"{full}/".startswith(allowed) and "__pycache__" not in full:
                found.append(f"{event} {name}")

    sys.addaudithook(hook)


def main() -> None:
    """Answer orders until there are no more."""
    room = str(Path(sys.argv[1]).resolve())
    orders, answers = os.fdopen(os.dup(0)), os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.chdir(room)
    resource.setrlimit(resource.RLIMIT_AS, (MOST_ADDRESSES, resource.getrlimit(resource.RLIMIT_AS)[1]))

    from orchestrator.cli import diagnosis as cli
    from orchestrator.cli.main import main as command

    written: list[str] = []
    watch(room + "/", written)
    stage = cli._Bar.stage
    stop = None

    def stopped(bar: Any, name: str) -> None:
        if name == stop:
            raise Enough
        stage(bar, name)

    cli._Bar.stage = stopped  # type: ignore[method-assign]
    for line in orders:
        order = json.loads(line)
        stop = order["stop"]
        os.chdir(order["folder"])
        output = os.open(order["output"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(output, 1)
        os.dup2(output, 2)
        os.close(output)
        written.clear()
        before, begin = resource.getrusage(resource.RUSAGE_SELF), os.times()
        try:
            status: Any = command(order["arguments"])
        except Enough:
            status = 0
        except SystemExit as end:
            status = end.code
        except BaseException:
            traceback.print_exc()
            status = "an exception"
        sys.stdout.flush()
        sys.stderr.flush()
        after, end_ = resource.getrusage(resource.RUSAGE_SELF), os.times()
        reported = {
            "status": status,
            "seconds": sum(end_[:4]) - sum(begin[:4]),
            "memory": 1024 * (after.ru_maxrss - before.ru_maxrss),
            "written": written[:5],
        }
        answers.write(json.dumps(reported) + "\n")
        answers.flush()


if __name__ == "__main__":
    main()
