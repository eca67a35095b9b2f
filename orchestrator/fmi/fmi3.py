"""Instances of FMI 3.0 co-simulation FMUs.

Where event mode is asked for, an instance returns from a step at its events, has them handled, and goes on to
the end of the step: a communication point that is an event shows the values after it.

Where the FMU provides intermediate update, inputs follow the master's curve within a step: intermediate.py.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
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
    c_uint,
    c_uint8,
    c_void_p,
    cast,
    string_at,
)
from typing import Any

from ..base.errors import StepError
from .binary_instance import MOST_ITERATIONS, NativeCalls, StatefulInstance
from .instance import Array, Point, StepStatus
from .intermediate import Intermediate, Watcher
from .variable import Kind, Value, Variable

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
_MOST_RETURNS = 10_000
# Part of a step that counts as nothing: far above the rounding of its ends, far below what can matter.
_CLOSE = 1e-9


class Fmi3Instance(StatefulInstance):
    """A running FMI 3.0 FMU."""

    _EXIT, _TERMINATE, _FREE = "fmi3ExitInitializationMode", "fmi3Terminate", "fmi3FreeInstance"
    _INSTANTIATE, _RESET = "fmi3InstantiateCoSimulation", "fmi3Reset"
    _SAVE, _RESTORE, _DROP = "fmi3GetFMUState", "fmi3SetFMUState", "fmi3FreeFMUState"
    _SIZE, _WRITE = "fmi3SerializedFMUStateSize", "fmi3SerializeFMUState"
    _READ, _BYTE = "fmi3DeserializeFMUState", c_uint8
    _FLAGS = "canGetAndSetFMUState", "canSerializeFMUState"
    _stepping = False
    # Whether the FMU asked to end the simulation when its inputs changed, or at the start.
    _wants_end = False
    _intermediate: Intermediate | None = None

    def _instantiate(self) -> None:
        def log(environment: Any, status: int, category: Any, message: Any) -> None:
            self._log.add(status, message, category)

        self._function(self._INSTANTIATE)
        try:
            self._slave.instantiate(loggingOn=True, logMessage=log, **self._modes())
        except Exception as error:
            raise self._instantiation_failed() from error
        self._component = self._slave.component
        self._find_functions()

    def _modes(self) -> dict[str, Any]:
        wanted, able = self.run_options.event_mode, self.description.capabilities
        modes = {"eventModeUsed": wanted, "earlyReturnAllowed": wanted}
        if able.intermediate_update:
            self._intermediate = Intermediate(self)
            ports = (*self.description.inputs, *self.description.outputs)
            references = dict.fromkeys(v.reference for v in ports if v.intermediate and v.kind.numeric)
            modes |= {
                "earlyReturnAllowed": wanted or able.return_on_request,
                "intermediateUpdate": self._intermediate.update,
                "requiredIntermediateVariables": list(references),
            }
        return modes

    def bind(self, inputs: Sequence[str], u: Array, outputs: Sequence[str], y: Array) -> None:
        """See FmuInstance.bind."""
        super().bind(inputs, u, outputs, y)
        self._u = u
        if self._intermediate is not None:
            self._intermediate.bind(inputs, outputs, self._blocks)

    def watch(self, watcher: Watcher | None) -> None:
        """Have the bound outputs shown at the points within a step at which the FMU lets them be got.

        What the watcher raises ends the step, early where the FMU can, and is raised by `do_step`.

        Args:
            watcher: called with the time [s] and the outputs, shape (outputs,), NaN where the FMU does not
                declare that they can be got within a step; None: no more.
        Raises: FmuError if the FMU does not provide intermediate update.
        """
        self._need("intermediate_update", "providesIntermediateUpdate")
        assert self._intermediate is not None
        self._intermediate.watcher = watcher

    def write_input_derivatives(self, order: int, values: Array) -> None:
        """See FmuInstance.write_input_derivatives."""
        self._need("intermediate_update", "providesIntermediateUpdate")
        assert self._intermediate is not None
        self._intermediate.follow(order, self._u, values)

    def _complete_arrays(self) -> None:
        super()._complete_arrays()
        for block in self._intermediate.blocks if self._intermediate is not None else ():
            self._refill(block)

    def _find_functions(self) -> None:
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

    def enter_initialisation(
        self, start_time: float, start_values: Mapping[str, Value], stop_time: float | None = None
    ) -> None:
        """See FmuInstance.enter_initialisation; sizes of arrays are set first."""
        if self.run_options.structure:
            self._call("fmi3EnterConfigurationMode")
            super().set_values(dict(self.run_options.structure))
            self._call("fmi3ExitConfigurationMode")
        super().enter_initialisation(start_time, start_values, stop_time)

    def _enter(self, start_time: float, stop_time: float | None) -> None:
        arguments = (*self._tolerance_arguments(), start_time, stop_time is not None, stop_time or 0.0)
        self._call("fmi3EnterInitializationMode", *arguments)

    def exit_initialisation(self) -> None:
        """See FmuInstance.exit_initialisation."""
        super().exit_initialisation()
        if self.run_options.event_mode:
            self._wants_end = self._update_discrete_states()
            self._call("fmi3EnterStepMode")
            self._stepping = True

    def reset(self) -> None:
        super().reset()
        self._stepping = self._wants_end = False

    def write_inputs(self) -> None:
        """See FmuInstance.write_inputs; discrete inputs may change in event mode only."""
        if self._intermediate is not None:
            self._intermediate.hold()
        with self._event_mode():
            super().write_inputs()

    def set_values(self, values: Mapping[str, Value]) -> None:
        """See FmuInstance.set_values."""
        binary = {name: value for name, value in values.items() if isinstance(value, bytes)}
        with self._event_mode():
            super().set_values({name: value for name, value in values.items() if name not in binary})
            for name, value in binary.items():
                reference = c_uint(self.description.variables[name].reference)
                size, address = c_size_t(len(value)), c_char_p(value)
                self._access_binary("Set", name, reference, size, address)

    def get_values(self, names: Sequence[str]) -> dict[str, Value]:
        """See FmuInstance.get_values."""
        variables = self.description.variables
        binary = [name for name in names if variables[name].kind is Kind.BINARY and not variables[name].shape]
        values = super().get_values([name for name in names if name not in binary])
        for name in binary:
            # The FMU's own memory, which need not outlive the next call.
            size, address = c_size_t(0), c_void_p()
            self._access_binary("Get", name, c_uint(variables[name].reference), size, address)
            values[name] = string_at(address, size.value) if address.value and size.value else b""
        return values

    def _access_binary(self, verb: str, name: str, reference: Any, size: Any, address: Any) -> None:
        """Call fmi3GetBinary or fmi3SetBinary for one variable."""
        found = cast(self._function(f"fmi3{verb}Binary"), c_void_p).value
        call = CFUNCTYPE(c_int, c_void_p, c_void_p, c_size_t, c_void_p, c_void_p, c_size_t)(found)
        status = call(self._component, addressof(reference), 1, addressof(size), addressof(address), 1)
        if status > 1:
            self._fail(f"fmi3{verb}Binary of {name}", status)

    @contextmanager
    def _event_mode(self) -> Iterator[None]:
        """Event mode between two steps, where it is used."""
        if not self._stepping:
            yield
            return
        self._call("fmi3EnterEventMode")
        yield
        self._wants_end |= self._update_discrete_states()
        self._call("fmi3EnterStepMode")

    def do_step(self, point: Point) -> StepStatus:
        """See FmuInstance.do_step."""
        self._time = point.time
        time, length = point.time, point.step_size
        end = point.time + point.step_size
        if self._wants_end:
            self._reached.value = time
            return StepStatus.TERMINATED
        worst = StepStatus.OK
        between = self._intermediate
        if between is not None:
            between.begin(time)
        for _ in range(_MOST_RETURNS):
            status = self._do_step(self._handle, time, length, self._saved_states == 0, *self._returned)
            if between is not None:
                between.raise_failure()
            judged = self._status_of(status)
            if judged > StepStatus.WARNING:
                return judged
            worst = max(worst, judged)
            if self.run_options.event_mode and self._event.value:
                self._call("fmi3EnterEventMode")
                stop = self._update_discrete_states()
                self._call("fmi3EnterStepMode")
                if stop:
                    return StepStatus.TERMINATED
            # FMUs are met that return early without leave: they are made to finish their step as well.
            if not self._early.value or self._reached.value >= end - _CLOSE * point.step_size:
                return worst
            time, length = self._reached.value, end - self._reached.value
        raise StepError(
            f"fmi3DoStep returned early {_MOST_RETURNS} times within one step, it came to {time!r} s",
            instance=self.name,
            time=point.time,
            status="early return",
            log=self.log_lines(),
        )

    def _update_discrete_states(self) -> bool:
        """Iterate until the discrete states settle; whether the FMU asks to end the simulation."""
        more, stop, nominals, values, defined = (c_bool() for _ in range(5))
        time = c_double()
        arguments = [byref(one) for one in (more, stop, nominals, values, defined, time)]
        for _ in range(MOST_ITERATIONS):
            self._call("fmi3UpdateDiscreteStates", *arguments)
            if stop.value or not more.value:
                self._next_event = time.value if defined.value else None
                return stop.value
        raise self._unsettled("fmi3UpdateDiscreteStates")

    def native_calls(self) -> NativeCalls | None:
        watched = self._intermediate is not None and self._intermediate.watcher is not None
        if self.run_options.event_mode or watched or not self._moves_plainly():
            return None
        event, terminate, early, reached = (one.value or 0 for one in self._returned)
        return NativeCalls(
            version=3,
            component=self._handle.value or 0,
            step=cast(self._do_step, c_void_p).value or 0,
            no_rollback=self._saved_states == 0,
            returned=(event, terminate, early, reached),
            inputs=tuple(self._inputs),
            outputs=tuple(self._outputs),
        )

    def step_status(self, status: int, point: Point) -> StepStatus:
        judged = self._status_of(status)
        if (
            judged <= StepStatus.WARNING
            and self._early.value
            and self._reached.value < point.time + (1.0 - _CLOSE) * point.step_size
        ):
            raise StepError(
                f"fmi3DoStep returned early without leave, at {self._reached.value!r} s",
                instance=self.name,
                time=point.time,
                status="early return",
                log=self.log_lines(),
                remedy="Set run.loop to python: it makes such FMUs finish their step.",
            )
        return judged

    def _status_of(self, status: int) -> StepStatus:
        """What a status means, be the step complete or not. Raises: StepError."""
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

    def restore_state(self, state: c_void_p) -> None:
        super().restore_state(state)
        self._wants_end = False
