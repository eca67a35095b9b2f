"""A basin that fills over a step, and tells at once what flows in; no model description tells its state."""

from pythonfmu import Fmi2Causality, Fmi2Initial, Fmi2Slave, Real


class Basin(Fmi2Slave):
    description = "A basin"

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.inflow, self.level, self.flow = 0.0, 0.0, 0.0
        output = {"causality": Fmi2Causality.output}
        self.register_variable(Real("inflow", causality=Fmi2Causality.input, description="inflow"))
        self.register_variable(Real("level", initial=Fmi2Initial.exact, description="level", **output))
        self.register_variable(Real("flow", description="what flows in", **output))
        self.type_attributes = {"inflow": {"unit": "m/s"}, "level": {"unit": "m"}, "flow": {"unit": "m/s"}}
        self.dependencies = {"level": (), "flow": ("inflow",)}
        self.initial_dependencies = {"level": (), "flow": ()}

    def do_step(self, current_time, step_size):
        self.level = self.level + self.inflow * step_size
        self.flow = self.inflow
        return True
