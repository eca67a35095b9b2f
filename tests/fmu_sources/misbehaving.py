"""An integrator that fails in the way and at the time it is asked to."""

import math

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real, String
from pythonfmu.enums import Fmi2Status


class Misbehaving(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.rate = 0.0
        self.level = 0.0
        self.way = "none"
        self.at = 1.0e9
        parameter = {"causality": Fmi2Causality.parameter, "variability": Fmi2Variability.tunable}
        self.register_variable(Real("rate", causality=Fmi2Causality.input, start=0.0))
        self.register_variable(Real("level", causality=Fmi2Causality.output))
        self.register_variable(String("way", start="none", **parameter))
        self.register_variable(Real("at", start=1.0e9, **parameter))

    def do_step(self, current_time, step_size):
        self.level += self.rate * step_size
        if current_time >= self.at - 1e-12:
            if self.way == "nan":
                self.level = math.nan
            if self.way == "error":
                self.log("the tank is empty", Fmi2Status.error)
                raise RuntimeError("nothing left to integrate")
            if self.way == "terminate":
                return False
        if math.isnan(self.rate):
            raise RuntimeError("cannot integrate what is not a number")
        return True
