"""Instances of model-exchange FMUs, which look like co-simulation ones: CVODE integrates over each step.

Inputs are held over a step, so every change of theirs is an event at its beginning; where the master gives a
curve, continuous ones follow it wherever the integration looks. Events at the end of a
step belong to it: a communication point that is an event shows the values after it. Integration begins again
at every communication point, so that a step depends on nothing but the FMU's state and its inputs.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import ulp
from typing import Any

import numpy as np

from ..base.errors import StepError
from .binary_instance import CompiledInstance, NativeCalls
from .input_curves import InputCurves
from .instance import Array, Point, StepStatus
from .run_options import DEFAULT_TOLERANCE
from .solver import Integrator, Model
from .variable import Value

_MOST_STEPS = 100_000
# Part of a step within which an event counts as being at its end.
_CLOSE = 1e-9


class Exchange(CompiledInstance):
    """What model exchange has in common in all versions of FMI."""

    _SET_TIME = _GET_STATES = _SET_STATES = _DERIVATIVES = _INDICATORS = _NOMINALS = ""

    _integrator: Integrator | None = None
    _reached: float | None = None
    _next_event: float | None = None
    _running = False
    # Whether the FMU asked to end the simulation when its inputs changed, or at the start.
    _wants_end = False
    _sent: Array | None = None

    def __init__(self, *arguments: Any) -> None:
        self._curves = InputCurves(self)
        super().__init__(*arguments)

    # What differs between the versions.

    def _enter_event_mode(self) -> None: ...

    def _update_discrete(self) -> bool:
        """Iterate until the discrete states settle; whether the FMU asks to end the simulation."""
        raise NotImplementedError

    def _enter_continuous_time(self) -> None: ...

    def _completed_step(self) -> tuple[bool, bool]:
        """Report a completed integrator step; returns whether the FMU asks for an event, and for an end."""
        raise NotImplementedError

    def _sizes(self) -> tuple[int, int]:
        """Numbers of states and event indicators."""
        return self.description.states, self.description.event_indicators

    # Life.

    def _find_functions(self) -> None:
        """There are none that are called in every step."""

    def _enter(self, start_time: float, stop_time: float | None) -> None:
        super()._enter(start_time, stop_time)
        self._start_time = start_time

    def exit_initialisation(self) -> None:
        """See FmuInstance.exit_initialisation."""
        super().exit_initialisation()
        self._begin(self._start_time)

    def bind(self, inputs: Any, u: Array, outputs: Any, y: Array) -> None:
        """See FmuInstance.bind."""
        super().bind(inputs, u, outputs, y)
        self._u = u
        self._sent = None
        self._curves.bind_inputs(inputs, self._blocks)

    def _complete_arrays(self) -> None:
        super()._complete_arrays()
        for block in self._curves.blocks:
            self._refill(block)

    def _begin(self, start_time: float) -> None:
        """After initialisation: settle the discrete states and set the integrator up."""
        tolerance = self.run_options.tolerance or self.description.tolerance or DEFAULT_TOLERANCE
        self._time = start_time
        self._wants_end = self._settle()
        self._running = True
        states, indicators = self._sizes()
        if states or indicators:
            model = Model(
                set_time=self._set_time,
                get_states=lambda x, n: self._call(self._GET_STATES, x, n),
                set_states=lambda x, n: self._call(self._SET_STATES, x, n),
                get_derivatives=lambda x, n: self._call(self._DERIVATIVES, x, n),
                get_indicators=lambda z, n: self._call(self._INDICATORS, z, n),
                get_nominals=self._get_nominals,
            )
            self._integrator = Integrator(model, states, indicators, start_time, tolerance)

    def _set_time(self, time: float) -> None:
        """The instant at which the model is evaluated, with the inputs that belong to it."""
        self._call(self._SET_TIME, time)
        self._curves.set(time)

    def _get_nominals(self, values: Any, count: int) -> None:
        if self._NOMINALS in self._slave._functions:
            self._call(self._NOMINALS, values, count)
        for index in range(count):
            if self._NOMINALS not in self._slave._functions or values[index] == 0.0:
                values[index] = 1.0

    def _settle(self) -> bool:
        """From event mode to continuous-time mode; whether the FMU asks to end the simulation."""
        stop = self._update_discrete()
        if not stop:
            self._enter_continuous_time()
        return stop

    def reset(self) -> None:
        self._drop_integrator()
        self._running, self._wants_end, self._sent = False, False, None
        self._curves.hold()
        super().reset()

    def free(self) -> None:
        """See FmuInstance.free."""
        self._drop_integrator()
        super().free()

    def _drop_integrator(self) -> None:
        if self._integrator is not None:
            self._integrator.close()
            self._integrator = None

    # Values.

    def set_values(self, values: Mapping[str, Value]) -> None:
        """See FmuInstance.set_values."""
        if not self._running:
            super().set_values(values)
            return
        self._enter_event_mode()
        super().set_values(values)
        self._wants_end |= self._settle()

    def write_inputs(self) -> None:
        """See FmuInstance.write_inputs; inputs that stay as they are cause no event."""
        if self._curves.has_curve:
            self._sent = None  # the FMU holds the values at the end of the last curve
        self._curves.hold()
        if self._sent is not None and np.array_equal(self._u, self._sent):
            return
        if self._u.size:
            self._enter_event_mode()
            super().write_inputs()
            self._wants_end |= self._settle()
        self._sent = self._u.copy()

    def write_input_derivatives(self, order: int, values: Array) -> None:
        """See FmuInstance.write_input_derivatives."""
        self._curves.follow(order, self._u, values)

    # Steps.

    def native_calls(self) -> NativeCalls | None:
        """See CompiledInstance.native_calls; integration is Python's."""
        return None

    def do_step(self, point: Point) -> StepStatus:
        """See FmuInstance.do_step."""
        self._time = self._reached = time = point.time
        if self._wants_end:
            return StepStatus.TERMINATED
        self._curves.begin(time)
        end = point.time + point.step_size
        close = max(_CLOSE * point.step_size, 8.0 * ulp(end))
        if self._integrator is not None:
            self._integrator.reset(time)
        events = 0
        for _ in range(_MOST_STEPS):
            event = self._next_event
            if event is not None and event <= time + close:
                events += 1
                # Never before the event, be it by rounding: the FMU would not see it.
                self._reached = max(time, event)
                if self._handle_event(self._reached):
                    return StepStatus.TERMINATED
                continue
            if time >= end - close:
                return StepStatus.OK
            goal = end if event is None or event > end + close else min(event, end)
            time, due = self._integrate(goal)
            self._reached = time
            if self.description.completed_step:
                wanted, stop = self._completed_step()
                if stop:
                    return StepStatus.TERMINATED
                due = due or wanted
            if due:
                events += 1
                if self._handle_event(time):
                    return StepStatus.TERMINATED
        raise StepError(
            f"the step of {point.step_size:.12g} s came only {time - point.time:.3g} s far in {_MOST_STEPS} "
            f"integration steps and events, the most allowed; {events} were events",
            instance=self.name,
            time=self._time,
            status="not integrated",
            log=self.log_lines(),
            remedy=self._remedy(events),
        )

    def _remedy(self, events: int) -> str:
        """What to do about a step that takes too many integration steps or `events`."""
        # After an event the integration begins again, with some short steps.
        if 10 * events > _MOST_STEPS:
            return (
                "Its events come without an end: give what switches in the FMU a hysteresis or a least time "
                "between two events, or take a smaller step size if there are but many of them."
            )
        return (
            f"Loosen instances.{self.name}.tolerance, or take a smaller step size; if neither helps, a "
            "derivative of the FMU jumps or grows without bound there: make the jump an event, or give it a "
            "finite slope."
        )

    def _integrate(self, goal: float) -> tuple[float, bool]:
        if self._integrator is None:
            self._set_time(goal)
            return goal, False
        try:
            return self._integrator.advance(goal)
        except RuntimeError as error:
            remedy = f"Loosen instances.{self.name}.tolerance, or take a smaller step size."
            raise StepError(
                str(error),
                instance=self.name,
                time=self._time,
                status="not integrated",
                log=self.log_lines(),
                remedy=remedy,
            ) from error

    def _handle_event(self, time: float) -> bool:
        self._set_time(time)
        self._enter_event_mode()
        stop = self._settle()
        if self._integrator is not None and not stop:
            self._integrator.reset(time)
        return stop

    def last_successful_time(self) -> float | None:
        """See FmuInstance.last_successful_time."""
        return self._reached

    # States: what the FMU holds, and what is held here.

    def save_state(self) -> Any:
        """See FmuInstance.save_state."""
        return super().save_state(), self._next_event, self._sent  # type: ignore[misc]

    def restore_state(self, state: Any) -> None:
        """See FmuInstance.restore_state."""
        inner, self._next_event, self._sent = state
        self._wants_end = False
        super().restore_state(inner)  # type: ignore[misc]

    def free_state(self, state: Any) -> None:
        """See FmuInstance.free_state."""
        super().free_state(state[0])  # type: ignore[misc]

    def serialise_state(self, state: Any) -> bytes:
        """See FmuInstance.serialise_state."""
        event = np.array([np.nan if state[1] is None else state[1]])
        return event.tobytes() + super().serialise_state(state[0])  # type: ignore[misc]

    def deserialise_state(self, data: bytes) -> Any:
        """See FmuInstance.deserialise_state."""
        event = float(np.frombuffer(data[:8])[0])
        inner = super().deserialise_state(data[8:])  # type: ignore[misc]
        return inner, None if np.isnan(event) else event, None
