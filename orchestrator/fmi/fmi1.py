"""Instances of FMI 1.0 co-simulation FMUs.

FMI 1.0 has no initialisation mode: an FMU takes start values, is initialised by one call, and can be read
only after it. That call is put off until the first value is asked for or the initialisation ends, so that
inputs which do not wait for an output of the same FMU are set before it.
"""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import c_char_p, c_double, c_int, c_uint8
from typing import Any

from ..base.errors import FmuError
from .binary_instance import PENDING, CompiledInstance
from .instance import Point, StepStatus
from .library import callbacks1
from .variable import Value, Variable

_TYPES = {
    "Real": (c_double, "Real"),
    "Integer": (c_int, "Integer"),
    "Enumeration": (c_int, "Integer"),
    "Boolean": (c_uint8, "Boolean"),
    "String": (c_char_p, "String"),
}
_DISCARD = 2
_TRUE, _FALSE = b"\x01", b"\x00"


class Fmi1Base(CompiledInstance):
    """What both interfaces of FMI 1.0 have in common."""

    _started: tuple[float, float | None] | None = None
    _initialised = False

    def _instantiate(self) -> None:
        self._function(self._INSTANTIATE)
        try:
            self._slave.instantiate(functions=callbacks1(), loggingOn=True)
        except Exception as error:
            raise self._instantiation_failed() from error
        if not self._slave.component:
            raise self._instantiation_failed()
        self._component = self._slave.component
        self._find_functions()

    def reset(self) -> None:
        super().reset()
        self._started, self._initialised = None, False

    def _find_functions(self) -> None:
        """Look up what is called in every step."""

    def _accessor(self, variable: Variable, verb: str) -> tuple[Any, Any]:
        ctype, name = _TYPES[variable.type]
        return ctype, self._function(f"fmi1{verb}{name}")

    def _derivative(
        self, unknowns: Any, counts: tuple[int, int], knowns: Any, seed: Any, answer: Any
    ) -> None:
        raise FmuError(f"{self.path}: FMI 1.0 has no directional derivatives")

    def _enter(self, start_time: float, stop_time: float | None) -> None:
        self._started = start_time, stop_time

    def get_values(self, names: Sequence[str]) -> dict[str, Value]:
        """See FmuInstance.get_values."""
        self._finish_initialisation()
        return super().get_values(names)

    def exit_initialisation(self) -> None:
        """See FmuInstance.exit_initialisation."""
        self._finish_initialisation()

    def _finish_initialisation(self) -> None:
        if not self._initialised and self._started is not None:
            self._initialised = True
            self._initialise(*self._started)

    def _initialise(self, start_time: float, stop_time: float | None) -> None:
        raise NotImplementedError


class Fmi1Instance(Fmi1Base):
    """A running FMI 1.0 co-simulation FMU."""

    _INSTANTIATE, _TERMINATE = "fmi1InstantiateSlave", "fmi1TerminateSlave"
    _RESET = "fmi1ResetSlave"
    _FREE = "fmi1FreeSlaveInstance"
    _STATUS, _REAL_STATUS = "fmi1GetStatus", "fmi1GetRealStatus"

    def _find_functions(self) -> None:
        self._do_step = self._function("fmi1DoStep")

    def _initialise(self, start_time: float, stop_time: float | None) -> None:
        defined = _FALSE if stop_time is None else _TRUE
        self._call("fmi1InitializeSlave", start_time, defined, stop_time or 0.0)

    def do_step(self, point: Point) -> StepStatus:
        """See FmuInstance.do_step."""
        self._time = point.time
        status = self._do_step(self._component, point.time, point.step_size, _TRUE)
        if status == PENDING:
            status = self._wait()
        if status <= 1:
            return StepStatus.WARNING if status else StepStatus.OK
        if status == _DISCARD:
            return StepStatus.DISCARD
        self._fail("fmi1DoStep", status)
