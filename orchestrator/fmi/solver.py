"""CVODE, by way of fmpy, as the integrator of a model-exchange FMU."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from ctypes import POINTER, byref, c_double, c_int, c_void_p
from typing import Any, NamedTuple

from fmpy import sundials
from fmpy.sundials import cvode, libraries
from fmpy.sundials.nvector_serial import NV_DATA_S

from ..base.errors import StepError

_ONE_STEP, _ROOT_RETURN = 2, 2
# fmpy leaves these out.
_set_stop_time = libraries.sundials_cvode.CVodeSetStopTime
_set_stop_time.argtypes, _set_stop_time.restype = [c_void_p, c_double], c_int
_clear_handlers = libraries.sundials_core.SUNContext_ClearErrHandlers
_clear_handlers.argtypes, _clear_handlers.restype = [c_void_p], c_int
_free_context = libraries.sundials_core.SUNContext_Free
_free_context.argtypes, _free_context.restype = [POINTER(c_void_p)], c_int
_free_matrix = libraries.sundials_core.SUNMatDestroy
_free_solver = libraries.sundials_core.SUNLinSolFree
_free_vector = libraries.sundials_core.N_VDestroy
for _function in (_free_matrix, _free_solver, _free_vector):
    _function.argtypes, _function.restype = [c_void_p], None


class Model(NamedTuple):
    """Functions of a model; vectors are pointers to doubles with their length. Each may raise StepError."""

    set_time: Callable[[float], Any]
    get_states: Callable[[Any, int], Any]
    set_states: Callable[[Any, int], Any]
    get_derivatives: Callable[[Any, int], Any]
    get_indicators: Callable[[Any, int], Any]
    get_nominals: Callable[[Any, int], Any]


class Integrator(sundials.CVodeSolver):
    """Integrates a model step by step: never beyond the end it is given, and it passes the model's errors on.

    fmpy's own `step` integrates beyond the end and interpolates, which an event at the end or an input that
    changes there forbids; and an error within a callback is printed there and otherwise lost.
    """

    def __init__(self, model: Model, states: int, indicators: int, time: float, tolerance: float) -> None:
        """
        Args:
            states, indicators: numbers of continuous states and of event indicators.
            time: where to begin [s].
            tolerance: relative; the absolute one of a state is this times its nominal value.
        """
        self._closed = False
        self._failure: StepError | None = None
        super().__init__(
            nx=states,
            nz=indicators,
            get_x=model.get_states,
            set_x=model.set_states,
            get_dx=model.get_derivatives,
            get_z=model.get_indicators,
            get_nominals=model.get_nominals,
            set_time=model.set_time,
            input=None,
            startTime=time,
            relativeTolerance=tolerance,
        )
        # The handler that stays below fmpy's writes every message to the standard error.
        _clear_handlers(self.sunctx)
        sundials.SUNContext_PushErrHandler(self.sunctx, self.ehfun_, None)

    def advance(self, end: float) -> tuple[float, bool]:
        """Take one integration step, towards `end` and no further.

        Returns: the time reached [s], and whether an event indicator changed its sign there. The model is
            left at that time with those states.
        Raises: StepError of the model; RuntimeError with CVODE's message.
        """
        _set_stop_time(self.cvode_mem, end)
        reached = c_double()
        flag = cvode.CVode(self.cvode_mem, end, self.x, byref(reached), _ONE_STEP)
        if self._failure is not None:
            failure, self._failure = self._failure, None
            raise failure
        if flag < 0:
            detail = self.error_info[3] if self.error_info else "no message"
            raise RuntimeError(f"CVODE gave up with code {flag} ({detail})")
        self.set_time(reached.value)
        if not self.discrete:
            self.set_x(self.px, self.nx)
        return reached.value, flag == _ROOT_RETURN

    def f(self, t: float, y: Any, ydot: Any, user_data: Any) -> int:  # fmpy's name
        """Right-hand side, for CVODE."""
        return self._guarded(super().f, t, y, ydot, user_data)

    def g(self, t: float, y: Any, gout: Any, user_data: Any) -> int:  # fmpy's name
        """Event indicators, for CVODE."""
        return self._guarded(self._indicators, t, y, gout)

    def _indicators(self, t: float, y: Any, gout: Any) -> int:
        self.set_time(t)
        if not self.discrete:
            self.set_x(NV_DATA_S(y), self.nx)
        self.get_z(gout, self.nz)
        return 0

    def _guarded(self, function: Callable[..., int], *arguments: Any) -> int:
        try:
            return function(*arguments)
        except StepError as error:
            if error.status == "discard":
                return 1  # the model cannot be evaluated there: CVODE tries a shorter step
            self._failure = error
            return -1

    def close(self) -> None:
        """Free CVODE's memory; safe to call twice."""
        if self._closed or not hasattr(self, "cvode_mem"):
            return
        self._closed = True
        cvode.CVodeFree(byref(c_void_p(self.cvode_mem)))
        _free_solver(ctypes.cast(self.LS, c_void_p))
        _free_matrix(ctypes.cast(self.A, c_void_p))
        for vector in (self.x, self.abstol):
            _free_vector(ctypes.cast(vector, c_void_p))
        _free_context(ctypes.cast(byref(self.sunctx), POINTER(c_void_p)))

    def __del__(self) -> None:
        self.close()
