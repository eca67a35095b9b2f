"""The shared library of an FMU, loaded through fmpy; log lines of its instances."""

from __future__ import annotations

import inspect
import itertools
import re
import shutil
import tempfile
import typing
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from ctypes import (
    CDLL,
    POINTER,
    addressof,
    byref,
    c_char_p,
    c_int,
    c_uint8,
    c_void_p,
    cast,
    memmove,
    sizeof,
)
from pathlib import Path
from types import UnionType
from typing import Any

from fmpy import fmi1, fmi2, fmi3

from ..base.errors import FmuError
from ..base.temporary_folders import scratch_root
from .description import ModelDescription
from .log_file import LogFile
from .run_options import Interface
from .working_directory import returning

_LOG_LENGTH = 50
_STATUS = ("ok", "warning", "discard", "error", "fatal", "pending")


class LogBook:
    """The latest log lines of one instance; all of them go to a file where the run has a folder."""

    _open: typing.ClassVar[dict[int, LogBook]] = {}
    _numbers = itertools.count(1)

    def __init__(self, name: str, time: Callable[[], float | None] = lambda: None) -> None:
        self.name = name
        self._time = time
        self._file = LogFile.of(name)
        self.number = next(self._numbers)
        self._lines: deque[str] = deque(maxlen=_LOG_LENGTH)
        self._open[self.number] = self

    def lines(self) -> tuple[str, ...]:
        """The lines, oldest first, each with its status in brackets."""
        return tuple(self._lines)

    def clear(self) -> None:
        """Forget the lines."""
        self._lines.clear()

    def close(self) -> None:
        """Take no more lines from FMI 2 callbacks."""
        self._open.pop(self.number, None)
        if self._file is not None:
            self._file.close()

    def add(self, status: int, message: bytes | None, category: bytes | None = None) -> None:
        """Keep a message; it may hold several lines."""
        text = (message or b"").decode("utf-8", errors="replace")
        label = _STATUS[status] if 0 <= status < len(_STATUS) else str(status)
        lines = [line.rstrip() for line in text.splitlines() if line.strip()]
        self._lines.extend(f"[{label}] {line}" for line in lines)
        if self._file is not None:
            of = (category or b"").decode("utf-8", errors="replace")
            self._file.write([f"[{label}]\t{of}\t{line}" for line in lines], self._time)

    @classmethod
    def dispatch(
        cls,
        environment: int | None,
        name: bytes | None,
        status: int,
        category: bytes | None,
        message: bytes | None,
    ) -> None:
        """Give an FMI 2 log message to the instance it belongs to."""
        book = cls._open.get(environment or 0)
        if book is None:  # some FMUs hand back no environment: go by the instance's name
            wanted = (name or b"").decode("utf-8", errors="replace")
            book = next((one for one in reversed(cls._open.values()) if one.name == wanted), None)
        if book is not None:
            book.add(status, message, category)


def _log_fmi2(environment: Any, name: Any, status: int, category: Any, message: Any) -> None:
    LogBook.dispatch(environment, name, status, category, message)


def _callbacks() -> fmi2.fmi2CallbackFunctions:
    callbacks = fmi2.fmi2CallbackFunctions()
    callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(_log_fmi2)
    callbacks.allocateMemory = fmi2.defaultCallbacks.allocateMemory
    callbacks.freeMemory = fmi2.defaultCallbacks.freeMemory
    # FMI 2 log messages are printf formats with arguments; ctypes cannot receive those, fmpy's proxy can.
    with suppress(ImportError, OSError, AttributeError):  # messages then arrive as bare formats
        _proxy_of_our_own().addLoggerProxy(c_void_p(addressof(callbacks)))
    return callbacks


def _proxy_of_our_own() -> CDLL:
    """A copy of fmpy's logging library that nobody else loads.

    The library keeps one logger for the process, that of its last caller: whoever simulates through
    fmpy beside us would have it call his logger with our messages, even one that is gone.
    """
    from fmpy.logging import logging

    original = Path(logging._name)
    with tempfile.TemporaryDirectory(
        prefix="fmu-logging-", dir=scratch_root(), ignore_cleanup_errors=True
    ) as folder:
        copy = Path(folder) / f"orchestrator-{original.name}"
        shutil.copyfile(original, copy)
        return CDLL(str(copy))


_CALLBACKS = _callbacks()


def callbacks_for(book: LogBook) -> fmi2.fmi2CallbackFunctions:
    """FMI 2 callbacks that log into `book`; they must outlive the instance."""
    callbacks = fmi2.fmi2CallbackFunctions()
    memmove(byref(callbacks), byref(_CALLBACKS), sizeof(callbacks))
    callbacks.componentEnvironment = book.number
    return callbacks


def callbacks1() -> fmi1.fmi1CallbackFunctions:
    """FMI 1 callbacks, shared by all instances: they log by the instance's name."""
    return _CALLBACKS1


def _make_callbacks1() -> fmi1.fmi1CallbackFunctions:
    callbacks = fmi1.fmi1CallbackFunctions()
    # The same function, since the proxy serves one logger in a process. Where FMI 2 hands over the
    # environment FMI 1 hands over the component, which is no number of a log book: the name decides.
    callbacks.logger = cast(_CALLBACKS.logger, fmi1.fmi1CallbackLoggerTYPE)
    callbacks.allocateMemory = fmi1.defaultCallbacks.allocateMemory
    callbacks.freeMemory = fmi1.defaultCallbacks.freeMemory
    callbacks.stepFinished = None
    return callbacks


_CALLBACKS1 = _make_callbacks1()


class _TolerantLoading:
    """Loads the FMI functions that the library has, instead of failing on the first one missing."""

    _signatures: typing.ClassVar[dict[type, list[tuple[str, list[str], list[Any], Any]]]] = {}

    def _loadFunctions(self) -> None:  # noqa: N802 (fmpy's name)
        for name, argument_names, argument_types, result in self._signature():
            try:
                function = getattr(self.dll, self._exported(name))
            except AttributeError:
                continue
            function.argnames, function.argtypes, function.restype = argument_names, argument_types, result
            self._functions[name] = function

    def _exported(self, name: str) -> str:
        return name

    @classmethod
    def _signature(cls) -> list[tuple[str, list[str], list[Any], Any]]:
        if cls not in _TolerantLoading._signatures:
            # fmpy keeps the C prototypes in the annotations of its wrappers.
            found = []
            for name, wrapper in inspect.getmembers(cls, inspect.isfunction):
                if re.match(r"fmi\dS?[A-Z]", name):
                    parameters = list(inspect.signature(wrapper).parameters.values())[1:]
                    types = [_first(parameter.annotation) for parameter in parameters]
                    result = {bytes: c_char_p, int: c_int}.get(
                        returned := inspect.signature(wrapper).return_annotation, returned
                    )
                    found.append((name, [parameter.name for parameter in parameters], types, result))
            _TolerantLoading._signatures[cls] = found
        return _TolerantLoading._signatures[cls]


def _first(annotation: Any) -> Any:
    return typing.get_args(annotation)[0] if isinstance(annotation, UnionType) else annotation


def release_python_state(library: Any) -> None:
    """Let a library made by pythonfmu drop its global state now, while that is safe.

    When the process ends, pythonfmu 0.7 destroys that state twice, which corrupts the heap and may
    abort an otherwise successful process. Once dropped there is nothing left to destroy; a later
    instance makes it again. Other libraries are not changed.

    Args:
        library: ctypes library.
    """
    finalise = getattr(library, "finalizePythonInterpreter", None)
    if finalise is not None:
        finalise()


class _Fmi1Loading(_TolerantLoading):
    """FMI 1.0 functions carry the model's name; fmpy declares the results of some of them wrongly."""

    def _exported(self, name: str) -> str:
        return f"{self.modelIdentifier}_{name.replace('fmi1', 'fmi', 1)}"  # type: ignore[attr-defined]

    def _loadFunctions(self) -> None:  # noqa: N802
        super()._loadFunctions()
        for name, function in self._functions.items():
            if not re.match("fmi1(Instantiate|Free|GetVersion|GetTypes|GetModelTypes)", name):
                # InitializeSlave's status would be taken for the address of a text.
                function.restype = c_int
            if name in ("fmi1GetBoolean", "fmi1SetBoolean"):
                function.argtypes = [*function.argtypes[:3], POINTER(c_uint8)]


class _Fmi1Slave(_Fmi1Loading, fmi1.FMU1Slave):
    pass


class _Fmi1Model(_Fmi1Loading, fmi1.FMU1Model):
    pass


class _Fmi2Slave(_TolerantLoading, fmi2.FMU2Slave):
    def freeLibrary(self) -> None:  # fmpy's name  # noqa: N802
        release_python_state(self.dll)
        super().freeLibrary()


class _Fmi2Model(_TolerantLoading, fmi2.FMU2Model):
    pass


class _Fmi3Slave(_TolerantLoading, fmi3.FMU3Slave):
    pass


class _Fmi3Model(_TolerantLoading, fmi3.FMU3Model):
    pass


_LIBRARIES = {
    "1": (_Fmi1Slave, _Fmi1Model),
    "2": (_Fmi2Slave, _Fmi2Model),
    "3": (_Fmi3Slave, _Fmi3Model),
}


def load_library(path: Path, folder: Path, description: ModelDescription, name: str) -> Any:
    """Fmpy's object for one instance of an unpacked FMU.

    Raises: FmuError, naming the missing library where a dependency is not installed.
    """
    exchange = description.interface is Interface.MODEL_EXCHANGE
    kind = _LIBRARIES[description.fmi_version[0]][exchange]
    identifier = description.model_identifier
    tried: set[Path] = set()
    while True:
        try:
            # fmpy changes the working directory while it loads, and does not come back from a failure.
            with returning():
                return kind(
                    guid=description.token,
                    modelIdentifier=identifier,
                    unzipDirectory=str(folder),
                    instanceName=name,
                )
        except Exception as error:
            reason = str(error.__cause__ or error)
            if not _load_neighbour(folder, reason, tried):
                raise FmuError(_loading_message(path, identifier, reason)) from error


def _load_neighbour(folder: Path, reason: str, tried: set[Path]) -> bool:
    """Load a library that another one needs, if it stands beside it in the FMU; whether it was loaded.

    Linux looks there only if the library says so, which exporters forget; Windows looks there anyway. Once
    loaded it is found by its name, whoever needs it.
    """
    missing = re.search(r"([^\s:/]+): cannot open shared object file", reason)
    found = [] if missing is None else sorted(folder.glob(f"binaries/*/{missing[1]}"))
    if not found or found[0] in tried:
        return False
    tried.add(found[0])
    while True:
        try:
            CDLL(str(found[0]))
            return True
        except OSError as error:
            if not _load_neighbour(folder, str(error), tried):
                return False


def _loading_message(path: Path, identifier: str, reason: str) -> str:
    # glibc, then macOS.
    missing = re.search(r"([^\s:]+): cannot open shared object file", reason) or re.search(
        r"Library not loaded: (\S+)", reason
    )
    if missing and Path(missing[1]).stem != identifier:
        library = missing[1]
        return f"{path}: needs the library {library}, which is not installed\n  Install it."
    version = re.search(r"version `(\w+_[\d.]+)' not found", reason)
    if version:
        return f"{path}: was built for a newer system, it needs {version[1]}\n  Run it on a newer system."
    reason = re.sub(r"^Failed to load shared library \S+\. ", "", reason)
    return f"{path}: its library cannot be loaded ({reason})"
