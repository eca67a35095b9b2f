"""Instances of FMI 2.0 co-simulation FMUs."""

from __future__ import annotations

from ctypes import (
    CFUNCTYPE,
    addressof,
    byref,
    c_char,
    c_char_p,
    c_double,
    c_int,
    c_void_p,
    cast,
)
from typing import Any

from ..base.errors import StepError
from .binary_instance import PENDING, NativeCalls, StatefulInstance
from .instance import Array, Point, StepStatus
from .library import callbacks_for
from .variable import Variable

_TYPES = {
    "Real": (c_double, "Real"),
    "Integer": (c_int, "Integer"),
    "Enumeration": (c_int, "Integer"),
    "Boolean": (c_int, "Boolean"),
    "String": (c_char_p, "String"),
}
_DISCARD, _TERMINATED = 2, 3


class Fmi2Instance(StatefulInstance):
    """A running FMI 2.0 FMU."""

    _EXIT, _TERMINATE, _FREE = "fmi2ExitInitializationMode", "fmi2Terminate", "fmi2FreeInstance"
    _RESET, _BEND = "fmi2Reset", "fmi2SetRealInputDerivatives"
    _SAVE, _RESTORE, _DROP = "fmi2GetFMUstate", "fmi2SetFMUstate", "fmi2FreeFMUstate"
    _SIZE, _WRITE = "fmi2SerializedFMUstateSize", "fmi2SerializeFMUstate"
    _READ, _BYTE = "fmi2DeSerializeFMUstate", c_char
    _FLAGS = "canGetAndSetFMUstate", "canSerializeFMUstate"
    _STATUS, _REAL_STATUS, _BOOLEAN_STATUS = "fmi2GetStatus", "fmi2GetRealStatus", "fmi2GetBooleanStatus"

    def _instantiate(self) -> None:
        self._callbacks = callbacks_for(self._log)
        try:
            self._slave.instantiate(callbacks=self._callbacks, loggingOn=True)
        except Exception as error:
            raise self._instantiation_failed() from error
        self._component = self._slave.component
        self._find_functions()

    def _find_functions(self) -> None:
        self._handle = c_void_p(self._component)
        # Without fmpy's argument types a call takes half as long.
        do_step = CFUNCTYPE(c_int, c_void_p, c_double, c_double, c_int)
        self._do_step = do_step(cast(self._function("fmi2DoStep"), c_void_p).value)
        self._answers = c_int(), c_double()

    def _accessor(self, variable: Variable, verb: str) -> tuple[Any, Any]:
        ctype, name = _TYPES[variable.type]
        return ctype, self._function(f"fmi2{verb}{name}")

    def _enter(self, start_time: float, stop_time: float | None) -> None:
        defined, tolerance = self._tolerance_arguments()
        stop_defined = int(stop_time is not None)
        self._call("fmi2SetupExperiment", int(defined), tolerance, start_time, stop_defined, stop_time or 0.0)
        self._call("fmi2EnterInitializationMode")

    def do_step(self, point: Point) -> StepStatus:
        """See FmuInstance.do_step."""
        self._time = point.time
        status = self._do_step(self._handle, point.time, point.step_size, self._saved_states == 0)
        if status == PENDING:
            status = self._wait()
        return self.step_status(status, point)

    def native_calls(self) -> NativeCalls | None:
        if self.run_options.event_mode or not self._moves_plainly():
            return None
        return NativeCalls(
            version=2,
            component=self._handle.value or 0,
            step=cast(self._do_step, c_void_p).value or 0,
            no_rollback=self._saved_states == 0,
            returned=(0, addressof(self._answers[0]), 0, addressof(self._answers[1])),
            inputs=tuple(self._inputs),
            outputs=tuple(self._outputs),
            bend=self._address(self._BEND),
            asked=(self._address(self._BOOLEAN_STATUS), self._address(self._REAL_STATUS)),
        )

    def _address(self, name: str) -> int:
        """Of a function; 0 without it."""
        return cast(self._slave._functions.get(name), c_void_p).value or 0

    def step_status(self, status: int, point: Point) -> StepStatus:
        if status <= 1:
            return StepStatus.WARNING if status else StepStatus.OK
        if status == _DISCARD:
            return StepStatus.TERMINATED if self._asks_to_terminate() else StepStatus.DISCARD
        if status == PENDING:
            raise StepError(
                "fmi2DoStep goes on asynchronously",
                instance=self.name,
                time=point.time,
                status="pending",
                log=self.log_lines(),
                remedy="Set run.loop to python: it waits for such FMUs.",
            )
        self._fail("fmi2DoStep", status)

    def _asks_to_terminate(self) -> bool:
        function = self._slave._functions.get(self._BOOLEAN_STATUS)
        value = c_int(0)
        return (
            function is not None and function(self._component, _TERMINATED, byref(value)) <= 1 and bool(value)
        )

    def write_input_derivatives(self, order: int, values: Array) -> None:
        """See FmuInstance.write_input_derivatives."""
        for block in self._inputs:
            if block.real:
                count = len(block.references)
                orders = (c_int * count)(*[order] * count)
                numbers = (c_double * count).from_buffer(values[block.positions])
                self._call(self._BEND, block.references, count, orders, numbers)

    def _derivative(
        self, unknowns: Any, counts: tuple[int, int], knowns: Any, seed: Any, answer: Any
    ) -> None:
        self._call("fmi2GetDirectionalDerivative", unknowns, counts[0], knowns, counts[1], seed, answer)
