"""One variable of every FMI 2.0 type that pythonfmu knows; each output follows its input after a step."""

from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Integer, Real, String


class Types2(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        for name, kind, start in (
            ("real", Real, 0.0),
            ("count", Integer, 0),
            ("flag", Boolean, False),
            ("word", String, "nothing"),
        ):
            setattr(self, f"{name}_in", start)
            setattr(self, f"{name}_out", start)
            self.register_variable(kind(f"{name}_in", causality=Fmi2Causality.input, start=start))
            self.register_variable(kind(f"{name}_out", causality=Fmi2Causality.output))

    def do_step(self, current_time, step_size):
        self.real_out += self.real_in * step_size
        self.count_out = self.count_in + 1
        self.flag_out = not self.flag_in
        self.word_out = self.word_in + "!"
        return True
