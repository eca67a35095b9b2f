"""An FMU that cannot be made where the module it needs is not installed."""

from pythonfmu import Fmi2Slave


class Needy(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        if self.resources:
            import a_module_that_nobody_has  # noqa: F401

    def do_step(self, current_time, step_size):
        return True
