"""Tasks on a Dask cluster: each Dask worker does them in a child process, as this machine would."""

from __future__ import annotations

import pickle
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from ...base.digests import digest_of
from ...base.errors import ConfigError, OrchestratorError, Problem
from .hosted import _do, _threads_of
from .tasks import Failure, Outcome, Work

_SECONDS_TO_CONNECT = 10
# Tasks that wait at each thread of the cluster, so that none is idle while outcomes travel.
_AHEAD = 3


class ClusterPool:
    """A Dask cluster; see `Pool`."""

    def __init__(self, scheduler: Any) -> None:
        """
        Args:
            scheduler: address, or a cluster or client of Dask.
        Raises: ConfigError if Dask is not installed, nobody answers, or the workers do not have this product.
        """
        try:
            from distributed import Client
        except ImportError:
            raise ConfigError(
                [Problem("--scheduler", "Dask is not installed", remedy="Install the extra `cluster`.")]
            ) from None
        self._own = not isinstance(scheduler, Client)
        self._where = str(getattr(scheduler, "scheduler_address", scheduler))
        if self._own:
            try:
                self._client = Client(scheduler, timeout=_SECONDS_TO_CONNECT, set_as_default=False)
            except (OSError, ValueError, TimeoutError) as error:
                what = f"no Dask scheduler answers at {self._where} ({_first(error)})"
                allowed = "an address such as tcp://HOST:8786"
                raise ConfigError([Problem("--scheduler", what, allowed)]) from None
        else:
            self._client = scheduler
        try:
            self._client.wait_for_workers(1, timeout=_SECONDS_TO_CONNECT)
        except TimeoutError:
            self.close()
            what = f"{self._where} has no workers"
            raise ConfigError([Problem("--scheduler", what, remedy="Start some: dask worker.")]) from None

    def close(self) -> None:
        """Leave the cluster as it is."""
        if self._own:
            self._client.close()

    def outcomes(self, work: Work, tasks: Iterable[Any], folder: Path | None = None) -> Iterator[Outcome]:
        """See `Pool.outcomes`; `folder` is not asked for: files travel."""
        from distributed import as_completed

        data = pickle.dumps(_bare(work))
        files = {place: path.read_bytes() for place, path in work.files.items()}
        name = "orchestrator-" + digest_of(data + "".join(sorted(files)).encode())[:24]
        try:
            self._client.register_plugin(_plugin(name, data, files), name=name)
            threads = self._client.run(_threads_of, name)
        except Exception as error:
            raise OrchestratorError(
                f"{self._where}: its workers cannot do this: {_first(error)}\n"
                "  They need the same version of this product as is installed here."
            ) from error
        left = iter(tasks)
        room = _AHEAD * max(sum(threads.values()), 1)
        waiting: dict[Any, Any] = {}
        done = as_completed(loop=self._client.loop)
        count = 0
        try:
            while True:
                while len(waiting) < room:
                    try:
                        task = next(left)
                    except StopIteration:
                        break
                    count += 1
                    future = self._client.submit(_do, name, task, key=f"{name}-{count}", pure=False)
                    waiting[future.key] = task
                    done.add(future)
                if not waiting:
                    break
                future = next(done)
                task = waiting.pop(future.key)
                yield self._outcome(future, task)
                future.release()
        finally:
            done.clear()
            try:
                self._client.unregister_worker_plugin(name)
            except Exception:  # the cluster may be gone
                pass

    def _outcome(self, future: Any, task: Any) -> Outcome:
        error = future.exception()
        if error is None:
            made, attempts = future.result()
            return Outcome(task, made.value, made.failure, attempts, made.seconds)
        if type(error).__name__ == "KilledWorker":
            failure = Failure(
                "killed", "the cluster's workers that it was given to died, one after the other"
            )
            return Outcome(task, None, failure, 4, 0.0)
        raise OrchestratorError(f"{self._where}: {_first(error)}") from error


def _bare(work: Work) -> dict[str, Any]:
    """A work without its files, which travel beside it."""
    state = {name: getattr(work, name) for name in work.__dataclass_fields__}
    return state | {"files": {}}


def _first(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


def _plugin(name: str, data: bytes, files: Mapping[str, bytes]) -> Any:
    from .plugin import WorkPlugin

    return WorkPlugin(name, data, files)
