"""y = k * u + c at once, at every communication point and during initialisation."""

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real


class Amplifier(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.u, self.k, self.c = 0.0, 1.0, 0.0
        self.register_variable(Real("u", causality=Fmi2Causality.input, start=0.0))
        for name, start in (("k", 1.0), ("c", 0.0)):
            kind = {"causality": Fmi2Causality.parameter, "variability": Fmi2Variability.tunable}
            self.register_variable(Real(name, start=start, **kind))
        self.register_variable(Real("y", causality=Fmi2Causality.output, getter=self._y))

    def _y(self):
        return self.k * self.u + self.c

    def do_step(self, current_time, step_size):
        return True
