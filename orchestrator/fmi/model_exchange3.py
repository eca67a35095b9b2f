"""Instances of FMI 3.0 model-exchange FMUs."""

from __future__ import annotations

from ctypes import byref, c_bool, c_size_t
from typing import Any

from .fmi3 import Fmi3Instance
from .model_exchange import Exchange


class Fmi3Exchange(Exchange, Fmi3Instance):
    """A running FMI 3.0 model-exchange FMU."""

    _INSTANTIATE = "fmi3InstantiateModelExchange"
    _SET_TIME, _GET_STATES, _SET_STATES = "fmi3SetTime", "fmi3GetContinuousStates", "fmi3SetContinuousStates"
    _DERIVATIVES, _INDICATORS = "fmi3GetContinuousStateDerivatives", "fmi3GetEventIndicators"
    _NOMINALS = "fmi3GetNominalsOfContinuousStates"

    def _modes(self) -> dict[str, Any]:
        return {}

    def _sizes(self) -> tuple[int, int]:
        found = []
        for name, declared in zip(
            ("fmi3GetNumberOfContinuousStates", "fmi3GetNumberOfEventIndicators"),
            super()._sizes(),
            strict=True,
        ):
            size = c_size_t(declared)
            if name in self._slave._functions:
                self._call(name, byref(size))
            found.append(size.value)
        return found[0], found[1]

    def _enter_event_mode(self) -> None:
        self._call("fmi3EnterEventMode")

    def _enter_continuous_time(self) -> None:
        self._call("fmi3EnterContinuousTimeMode")

    def _update_discrete(self) -> bool:
        return self._update_discrete_states()

    def _completed_step(self) -> tuple[bool, bool]:
        event, stop = c_bool(), c_bool()
        self._call("fmi3CompletedIntegratorStep", self._saved_states == 0, byref(event), byref(stop))
        return event.value, stop.value
