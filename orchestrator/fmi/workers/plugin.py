"""What Dask gives to each worker of a cluster, to those that join later, too."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from distributed import WorkerPlugin

from .hosted import dismiss, host


class WorkPlugin(WorkerPlugin):
    """A work and its files; the scheduler sends it once to each worker."""

    def __init__(self, name: str, data: bytes, files: Mapping[str, bytes]) -> None:
        self.name = name
        self._content = data, dict(files)

    def setup(self, worker: Any) -> None:
        """Take it in."""
        host(self.name, *self._content)

    def teardown(self, worker: Any) -> None:
        """End its processes."""
        dismiss(self.name)
