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
    following = get_context("fork").Value("i", 0)
    made = [_begun(tasks, following) for _ in range(count)]
    found: dict[int, Any] = {}
    try:
        for receiver, process in made:
            found |= _received(process, receiver)
    finally:
        for _, process in made:
            process.kill()
            process.join()
    return _results(found, len(tasks))


def in_time(task: Callable[[], T], seconds: float) -> T | None:
    """The result of a task, None if it takes longer; where no copies are made, it takes what it needs.

    Raises: what the task raises; RuntimeError if the copy was killed.
    """
    if sys.platform != "linux":
        return task()
    receiver, process = _begun([task], get_context("fork").Value("i", 0))
    try:
        return _results(_received(process, receiver), 1)[0] if receiver.poll(seconds) else None
    finally:
        process.kill()
        process.join()


def _begun(tasks: Sequence[Callable[[], Any]], following: Any) -> tuple[Any, Any]:
    """A copy of this process that takes tasks, and the end of its pipe."""
    context = get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(tasks, following, sender), daemon=True)
    with warnings.catch_warnings():
        # Python 3.12 warns if there are threads. Copies use none of their locks.
        warnings.simplefilter("ignore", DeprecationWarning)
        process.start()
    sender.close()
    return receiver, process


def _received(process: Any, receiver: Any) -> dict[int, Any]:
    """What a copy has found, by the number of the task. Raises: RuntimeError if it was killed."""
    try:
        found: dict[int, Any] = pickle.loads(receiver.recv_bytes())
    except EOFError:
        process.join()
        raise RuntimeError(f"a copy of the process ended with code {process.exitcode}") from None
    process.join()
    return found


def _results(found: dict[int, Any], count: int) -> list[Any]:
    """Results in their order. Raises: what the first task that failed has raised."""
    failed = next((found[k] for k in sorted(found) if isinstance(found[k], Exception)), None)
    if failed is not None:
        raise failed
    return [found[k] for k in range(count)]


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
