"""Many tasks on many processes: on this machine's cores, or on a Dask cluster, by the same call.

A task runs in a child process that can be ended: one that crashes or hangs costs its task, nothing else.
"""

from .local import LocalPool, cores
from .tasks import Attempt, Failure, Outcome, Pool, Retry, Work

__all__ = ["Attempt", "Failure", "LocalPool", "Outcome", "Pool", "Retry", "Work", "cores", "pool_of"]


def pool_of(scheduler: object = None, jobs: int | None = None) -> Pool:
    """What runs tasks.

    Args:
        scheduler: None: processes of this machine; otherwise the address of a Dask scheduler
            (`tcp://HOST:PORT`), or a Dask cluster or client.
        jobs: processes of this machine; as many as it lends cores by default.
    Raises: ConfigError if the scheduler cannot be reached, or Dask is not installed.
    """
    if scheduler is None:
        return LocalPool(jobs)
    # Imported late: Dask takes a second, and is installed only where it is wanted.
    from .cluster import ClusterPool

    return ClusterPool(scheduler)
