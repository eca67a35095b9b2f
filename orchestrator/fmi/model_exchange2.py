"""Instances of FMI 2.0 model-exchange FMUs."""

from __future__ import annotations

from ctypes import byref, c_int

from fmpy.fmi2 import fmi2EventInfo

from .binary_instance import MOST_ITERATIONS
from .fmi2 import Fmi2Instance
from .model_exchange import Exchange


class Fmi2Exchange(Exchange, Fmi2Instance):
    """A running FMI 2.0 model-exchange FMU."""

    _SET_TIME, _GET_STATES, _SET_STATES = "fmi2SetTime", "fmi2GetContinuousStates", "fmi2SetContinuousStates"
    _DERIVATIVES, _INDICATORS = "fmi2GetDerivatives", "fmi2GetEventIndicators"
    _NOMINALS = "fmi2GetNominalsOfContinuousStates"

    def _enter_event_mode(self) -> None:
        self._call("fmi2EnterEventMode")

    def _enter_continuous_time(self) -> None:
        self._call("fmi2EnterContinuousTimeMode")

    def _update_discrete(self) -> bool:
        info = fmi2EventInfo()
        for _ in range(MOST_ITERATIONS):
            self._call("fmi2NewDiscreteStates", byref(info))
            if info.terminateSimulation or not info.newDiscreteStatesNeeded:
                self._next_event = info.nextEventTime if info.nextEventTimeDefined else None
                return bool(info.terminateSimulation)
        raise self._unsettled("fmi2NewDiscreteStates")

    def _completed_step(self) -> tuple[bool, bool]:
        event, stop = c_int(), c_int()
        free = int(self._saved_states == 0)
        self._call("fmi2CompletedIntegratorStep", free, byref(event), byref(stop))
        return bool(event.value), bool(stop.value)
