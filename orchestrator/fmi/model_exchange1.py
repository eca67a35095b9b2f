"""Instances of FMI 1.0 model-exchange FMUs."""

from __future__ import annotations

from ctypes import byref, c_char, c_double

from fmpy.fmi1 import fmi1EventInfo

from .binary_instance import MOST_ITERATIONS
from .fmi1 import Fmi1Base
from .model_exchange import Exchange


class Fmi1Exchange(Exchange, Fmi1Base):
    """A running FMI 1.0 model-exchange FMU."""

    _INSTANTIATE, _TERMINATE, _FREE = "fmi1InstantiateModel", "fmi1Terminate", "fmi1FreeModelInstance"
    _SET_TIME, _GET_STATES, _SET_STATES = "fmi1SetTime", "fmi1GetContinuousStates", "fmi1SetContinuousStates"
    _DERIVATIVES, _INDICATORS = "fmi1GetDerivatives", "fmi1GetEventIndicators"
    _NOMINALS = "fmi1GetNominalContinuousStates"

    def _initialise(self, start_time: float, stop_time: float | None) -> None:
        self._call(self._SET_TIME, start_time)
        self._info = fmi1EventInfo()
        defined, tolerance = self._tolerance_arguments()
        controlled = b"\x01" if defined else b"\x00"
        self._call("fmi1Initialize", controlled, c_double(tolerance), byref(self._info))
        self._note_event()

    def _note_event(self) -> bool:
        defined = self._info.upcomingTimeEvent != b"\x00"
        self._next_event = self._info.nextEventTime if defined else None
        return self._info.terminateSimulation != b"\x00"

    def _update_discrete(self) -> bool:
        for _ in range(MOST_ITERATIONS):
            self._call("fmi1EventUpdate", b"\x00", byref(self._info))
            if self._note_event():
                return True
            if self._info.iterationConverged != b"\x00":
                return False
        raise self._unsettled("fmi1EventUpdate")

    def _completed_step(self) -> tuple[bool, bool]:
        event = c_char()
        self._call("fmi1CompletedIntegratorStep", byref(event))
        return event.value != b"\x00", False
