"""Instances of FMI 3.0 co-simulation FMUs, without event mode and early return."""

from __future__ import annotations

import ctypes
from ctypes import (
    CFUNCTYPE,
    addressof,
    byref,
    c_bool,
    c_char_p,
    c_double,
    c_float,
    c_int,
    c_int64,
    c_size_t,
    c_uint8,
    c_void_p,
    cast,
)
from typing import Any

from ..errors import FmuError
from .compiled import CompiledInstance
from .instance import Point, StepStatus
from .variable import Variable

__all__ = ["Fmi3Instance"]

_TYPES: dict[str, tuple[Any, str]] = {
    "Float64": (c_double, "Float64"),
    "Float32": (c_float, "Float32"),
    "Boolean": (c_bool, "Boolean"),
    "Enumeration": (c_int64, "Int64"),
    "String": (c_char_p, "String"),
}
for _bits in (8, 16, 32, 64):
    _TYPES[f"Int{_bits}"] = getattr(ctypes, f"c_int{_bits}"), f"Int{_bits}"
    _TYPES[f"UInt{_bits}"] = getattr(ctypes, f"c_uint{_bits}"), f"UInt{_bits}"
_DISCARD = 2


class Fmi3Instance(CompiledInstance):
    """A running FMI 3.0 FMU."""

    def _instantiate(self) -> None:
        def log(environment: Any, status: int, category: Any, message: Any) -> None:
            self._log.add(status, message)

        try:
            self._slave.instantiate(loggingOn=True, logMessage=log)
        except Exception as error:
            raise self._instantiation_failed() from error
        self._component = self._slave.component
        self._handle = c_void_p(self._component)
        # Without fmpy's argument types a call takes half as long.
        do_step = CFUNCTYPE(c_int, c_void_p, c_double, c_double, c_bool, *[c_void_p] * 4)
        self._do_step = do_step(cast(self._function("fmi3DoStep"), c_void_p).value)
        self._event, self._terminate, self._early = c_bool(), c_bool(), c_bool()
        self._reached = c_double()
        returned = (self._event, self._terminate, self._early, self._reached)
        self._returned = tuple(c_void_p(addressof(one)) for one in returned)

    def _accessor(self, variable: Variable, verb: str) -> tuple[Any, Any]:
        ctype, name = _TYPES[variable.type]
        return ctype, self._function(f"fmi3{verb}{name}")

    def _enter(self, start_time: float, stop_time: float | None) -> None:
        self._call(
            "fmi3EnterInitializationMode", False, 0.0, start_time, stop_time is not None, stop_time or 0.0
        )

    def do_step(self, point: Point) -> StepStatus:
        """See FmuInstance.do_step."""
        self._time = point.time
        status = self._do_step(
            self._handle, point.time, point.step_size, self._saved_states == 0, *self._returned
        )
        if status == _DISCARD:
            return StepStatus.DISCARD
        if status > 1:
            self._fail("fmi3DoStep", status)
        if self._terminate.value:
            return StepStatus.TERMINATED
        return StepStatus.WARNING if status else StepStatus.OK

    def last_successful_time(self) -> float | None:
        """See FmuInstance.last_successful_time."""
        return self._reached.value

    def _derivative(
        self, unknowns: Any, counts: tuple[int, int], knowns: Any, seed: Any, answer: Any
    ) -> None:
        rows, columns = counts
        name = "fmi3GetDirectionalDerivative"
        self._call(name, unknowns, rows, knowns, columns, seed, columns, answer, rows)

    def save_state(self) -> c_void_p:
        """See FmuInstance.save_state."""
        self._need("save_state", "canGetAndSetFMUState")
        state = c_void_p()
        self._call("fmi3GetFMUState", byref(state))
        self._saved_states += 1
        return state

    def restore_state(self, state: c_void_p) -> None:
        """See FmuInstance.restore_state."""
        self._call("fmi3SetFMUState", state)

    def free_state(self, state: c_void_p) -> None:
        """See FmuInstance.free_state."""
        self._call("fmi3FreeFMUState", byref(state))
        self._saved_states -= 1

    def serialise_state(self, state: c_void_p) -> bytes:
        """See FmuInstance.serialise_state."""
        self._need("serialise_state", "canSerializeFMUState")
        size = c_size_t()
        self._call("fmi3SerializedFMUStateSize", state, byref(size))
        buffer = (c_uint8 * size.value)()
        self._call("fmi3SerializeFMUState", state, buffer, size)
        return bytes(buffer)

    def deserialise_state(self, data: bytes) -> c_void_p:
        """See FmuInstance.deserialise_state."""
        self._need("serialise_state", "canSerializeFMUState")
        state = c_void_p()
        self._call("fmi3DeserializeFMUState", (c_uint8 * len(data))(*data), len(data), byref(state))
        self._saved_states += 1
        return state

    def _need(self, capability: str, flag: str) -> None:
        if not getattr(self.description.capabilities, capability):
            raise FmuError(
                f"{self.path}: instance {self.name} cannot do this, since the FMU does not declare {flag}"
            )
