"""Tasks side by side, each in a copy of this process, where the platform makes such copies cheaply."""

from __future__ import annotations

import os
import pickle
import sys
import warnings
from collections.abc import Callable, Sequence
from multiprocessing import get_context
from traceback import format_exc
from typing import Any, TypeVar

T = TypeVar("T")


def in_parallel(tasks: Sequence[Callable[[], T]]) -> list[T]:
    """The results of tasks, in their order.

    On Linux each core runs a copy of this process, which takes the next task when one ends. Changes that a
    task makes to objects of this process are lost. Elsewhere the tasks run one after the other.

    Raises: what the first task that fails has raised; RuntimeError if a copy was killed.
    """
    cores = len(os.sched_getaffinity(0)) if sys.platform == "linux" else 1
    count = min(len(tasks), cores)
    if count < 2:
        return [task() for task in tasks]
    context = get_context("fork")
    following = context.Value("i", 0)
    made = []
    for _ in range(count):
        receiver, sender = context.Pipe(duplex=False)
        process = context.Process(target=_work, args=(tasks, following, sender), daemon=True)
        with warnings.catch_warnings():
            # Python 3.12 warns if there are threads. Copies use none of their locks.
            warnings.simplefilter("ignore", DeprecationWarning)
            process.start()
        sender.close()
        made.append((process, receiver))
    found: dict[int, Any] = {}
    try:
        for process, receiver in made:
            try:
                found |= pickle.loads(receiver.recv_bytes())
            except EOFError:
                process.join()
                raise RuntimeError(f"a copy of the process ended with code {process.exitcode}") from None
            process.join()
    finally:
        for process, _ in made:
            process.kill()
            process.join()
    failed = next((found[k] for k in sorted(found) if isinstance(found[k], Exception)), None)
    if failed is not None:
        raise failed
    return [found[k] for k in range(len(tasks))]


def _work(tasks: Sequence[Callable[[], Any]], following: Any, sender: Any) -> None:
    """Take tasks until none is left or one fails, and send the results by their number."""
    found: dict[int, Any] = {}
    while True:
        with following.get_lock():
            number = following.value
            following.value += 1
        if number >= len(tasks):
            break
        try:
            found[number] = tasks[number]()
        except Exception as error:  # raised again by the parent
            error.add_note(format_exc())
            found[number] = error
            break
    sender.send_bytes(pickle.dumps(found))
    sender.close()
