"""FMUs from files, of FMI 1.0, 2.0 and 3.0."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property, lru_cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from ..base.digests import file_digest
from ..base.errors import FmuError
from .archive import Unpacked
from .description import ModelDescription, read_description
from .instance import FmuInstance
from .run_options import Interface, RunOptions

if TYPE_CHECKING:
    from .binary_instance import CompiledInstance


class CompiledFmu:
    """A .fmu file; see the Fmu protocol.

    Raises: FmuError if it is missing, malformed or has no interface that can be run.
    """

    def __init__(self, path: Path, run_options: RunOptions = RunOptions()) -> None:  # noqa: B008 (it is frozen)
        self.path: Path = path
        self.run_options = run_options
        found = read_description(path, run_options.interface, run_options.structure)
        if run_options.any_step:
            found = replace(found, own_step=None)
        if run_options.isolated:
            alone = replace(found.capabilities, once_per_process=False)
            found = replace(found, capabilities=alone)
        self.description: ModelDescription = found
        if run_options.event_mode and not self.description.capabilities.event_mode:
            raise FmuError(
                f"{path}: event_mode is asked for, which needs an FMI 3.0 co-simulation FMU that declares "
                f"hasEventMode\n  It is run as {self.description.interface} of FMI "
                f"{self.description.fmi_version}; take event_mode away."
            )

        exchange = found.interface is Interface.MODEL_EXCHANGE
        if run_options.tolerance is not None and found.fmi_version == "1.0" and not exchange:
            raise FmuError(
                f"{path}: a tolerance is given, which cannot be handed to a co-simulation FMU of FMI 1.0\n"
                "  Take tolerance away, or set a parameter of the FMU that does the same."
            )

    @cached_property
    def _unpacked(self) -> Unpacked:
        return Unpacked(self.path, self.description.fmi_version, self.description.model_identifier)

    def check(self) -> None:
        """Raises: FmuError if it cannot run on this platform."""
        self._unpacked.check()

    def instantiate(self, name: str) -> FmuInstance:
        """Unpack, load and instantiate. Raises: FmuError."""
        if self.run_options.isolated:
            from .isolated import IsolatedInstance

            return IsolatedInstance(name, self.path, self.description, self.run_options, self._unpacked)
        made = instance_class(self.description)
        return made(name, self.path, self.description, self._unpacked, self.run_options)

    @contextmanager
    def unpacked(self) -> Iterator[None]:
        """Keep the files unpacked, so that instances made one after another share them. Raises: FmuError."""
        self._unpacked.acquire()
        try:
            yield
        finally:
            self._unpacked.release()

    @property
    def corrupt(self) -> bool:
        """Whether an instance has returned "fatal", after which none may be used."""
        return self._unpacked.corrupt

    def checksum(self) -> str:
        """SHA-256 of the file."""
        return self._checksum

    @cached_property
    def _checksum(self) -> str:
        return f"sha256:{file_digest(self.path)}"


_KINDS = {
    ("1", Interface.CO_SIMULATION): (".fmi1", "Fmi1Instance"),
    ("2", Interface.CO_SIMULATION): (".fmi2", "Fmi2Instance"),
    ("3", Interface.CO_SIMULATION): (".fmi3", "Fmi3Instance"),
    ("1", Interface.MODEL_EXCHANGE): (".model_exchange1", "Fmi1Exchange"),
    ("2", Interface.MODEL_EXCHANGE): (".model_exchange2", "Fmi2Exchange"),
    ("3", Interface.MODEL_EXCHANGE): (".model_exchange3", "Fmi3Exchange"),
}


def instance_class(description: ModelDescription) -> Callable[..., CompiledInstance]:
    """The class whose instances run an FMU in this process."""
    # Loading fmpy's bindings is left until something runs.
    module, name = _KINDS[description.fmi_version[0], description.interface]
    return getattr(import_module(module, __package__), name)


@lru_cache(maxsize=256)
def _load(path: Path, modified: int, size: int, run_options: RunOptions) -> CompiledFmu:
    return CompiledFmu(path, run_options)


def load_fmu(path: Path | str, run_options: RunOptions = RunOptions()) -> CompiledFmu:  # noqa: B008 (it is frozen)
    """The FMU of a file, read once as long as the file stays the same. Raises: FmuError."""
    path = Path(path)
    if not path.is_file():
        raise FmuError(f"{path}: no such file")
    found = path.stat()
    return _load(path.resolve(), found.st_mtime_ns, found.st_size, run_options)
