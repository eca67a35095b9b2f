"""An FMU that cannot be made where the module it needs is not installed."""

from pythonfmu import Fmi2Causality, Fmi2Slave, Real


class Needy(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.level = 0.0
        self.register_variable(Real("level", causality=Fmi2Causality.output))
        if self.instance_name != "dummyInstance":  # what the builder calls it
            import a_module_that_nobody_has  # noqa: F401

    def do_step(self, current_time, step_size):
        return True
