"""The process of a worker: it does the tasks that it is reported over a pipe until the pipe ends."""

from __future__ import annotations

import gc
import os
import pickle
import sys
import traceback
from pathlib import Path
from typing import Any

from ...base.errors import OrchestratorError
from .. import messages as frames
from ..child_process import guarded_pipes

_FREED_EVERY = 64


def _error_text(error: BaseException) -> str:
    if isinstance(error, OrchestratorError):
        return str(error)
    place = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {error} ({Path(place.filename).name}:{place.lineno})"


def _resident() -> int:
    """Memory of this process [B]; 0 if the system does not report it."""
    try:
        with open("/proc/self/statm", encoding="ascii") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, AttributeError):
        return 0


def main() -> None:
    """Serve until the pipe ends."""
    commands, answers = guarded_pipes()
    context: Any = None
    function: Any = None
    begun = 0
    for number in range(sys.maxsize):
        try:
            message = pickle.loads(frames.receive(commands)[1])
        except EOFError:
            break
        except Exception as error:  # of the work: a module that is not there, say
            if number == 0:
                frames.send(answers, frames.ERROR, pickle.dumps((_error_text(error), 0)))
            break
        try:
            if number == 0:
                function, prepare, payload, folder = message
                context = payload if prepare is None else prepare(payload, folder)
                value = begun = _resident()
            else:
                value = function(context, message)
            if number % _FREED_EVERY == 0:
                gc.collect()
            answer = frames.VALUE, pickle.dumps((value, max(_resident() - begun, 0)), 5)
        except Exception as error:  # whatever a task raises: nothing but an answer gets out of here
            answer = frames.ERROR, pickle.dumps((_error_text(error), max(_resident() - begun, 0)))
        try:
            frames.send(answers, *answer)
        except OSError:
            break
    os._exit(0)  # threads and exit handlers of libraries are not waited for
