"""Plain Python code as expressions: the meaning of numbers, of branches, and what has no native form."""

from __future__ import annotations

import importlib.util
import math
import sys

import fmpy
import pytest
from fmpy.fmi2 import FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from hypothesis import example, given, settings
from hypothesis import strategies as st
from runtime_bench import needs_compiler

from orchestrator.base.errors import BuildError
from orchestrator.translate.component import trace_component
from orchestrator.translate.native_form import build_native_fmu
from orchestrator.translate.step_check import check_component

HEAD = """
import math
from math import hypot
from pythonfmu import Boolean, Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability, Integer, Real, String

class Model(Fmi2Slave):
    description = "model"

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.a = self.b = 0.0
        self.on = False
        self.count = 0
        names = [{names}]
        for name in names:
            setattr(self, name, 0.0)
        self.type_attributes = {{name: {{"unit": "1"}} for name in ("a", "b", *names)}}
        self.dependencies = {{name: () for name in names}}
        for name in ("a", "b"):
            self.register_variable(Real(name, causality=Fmi2Causality.input, description=name))
        self.register_variable(Boolean("on", causality=Fmi2Causality.input, description="on"))
        self.register_variable(Integer("count", causality=Fmi2Causality.input, description="count"))
        for name in names:
            self.register_variable(Real(
                name, causality=Fmi2Causality.output, initial=Fmi2Initial.exact, description=name))
{extra}
    def do_step(self, current_time, step_size):
{body}
        return True
{after}
"""


def write(folder, body, names=("y",), extra="", after=""):
    """A component whose step is the given lines; its states are `names`."""

    def indent(text):
        return "\n".join("        " + line for line in text.strip("\n").splitlines())

    text = HEAD.format(names=", ".join(map(repr, names)), body=indent(body), extra=indent(extra), after=after)
    path = folder / "model.py"
    path.write_text(text)
    return path


def load(path):
    spec = importlib.util.spec_from_file_location("model_under_test", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module.Model


MEANING = {
    "nearest": "round(self.a)",
    "half_up": "math.floor(self.a + 0.5)",
    "up": "math.ceil(self.a)",
    "whole": "int(self.a)",
    "rest": "self.a % self.b if self.b != 0.0 else 0.0",
    "quotient": "self.a // self.b if self.b != 0.0 else 0.0",
    "sign": "math.copysign(1.0, self.a)",
    "largest": "max(0.0, self.a, self.b)",
    "smallest": "min(self.b, self.a)",
    "power": "abs(self.a) ** 0.7 + self.b ** 2 + 0.98 ** (self.count + 2)",
    "length": "hypot(self.a, self.b)",
    "both": "1.0 if self.on and self.a < self.b else -1.0",
    "either": "float(self.on or self.a >= self.b) + (not self.on)",
    "chain": "self.count if -1.0 < self.a <= 1.0 else self.b",
    "order": "self.a + self.b - self.b",
    "truth": "(self.a > 0.0) + (self.count != 0) * 2 + bool(self.count)",
    "finite": "1.0 if math.isfinite(self.a) and not math.isnan(self.b) else 0.0",
    "time": "current_time / step_size",
    "odd": "self.count % 2",
}


@pytest.fixture(scope="module")
def meaning(tmp_path_factory):
    """The expressions above, as Python code and as functions."""
    body = "\n".join(f"self.out_{name} = {text}" for name, text in MEANING.items())
    path = write(tmp_path_factory.mktemp("meaning"), body, [f"out_{name}" for name in MEANING])
    return load(path)(instance_name="python"), trace_component(path, "Model")


NUMBERS = st.one_of(
    st.floats(-1e6, 1e6),
    st.integers(-20, 20).map(lambda n: n / 2.0),
    st.sampled_from([0.0, -0.0, 0.5, 1.5, -2.5]),
)


@given(a=NUMBERS, b=NUMBERS, on=st.booleans(), count=st.integers(-50, 50))
@example(a=0.49999999999999994, b=1.0, on=True, count=0)
@example(a=4503599627370497.5, b=-3.0, on=False, count=7)
@settings(deadline=None, max_examples=300)
def test_numbers_mean_what_they_mean_in_python(meaning, a, b, on, count):
    model, program = meaning
    model.a, model.b, model.on, model.count = a, b, on, count
    assert model.do_step(0.3, 0.1)
    states, outcome = program.advance(0.3, 0.1, [0.0] * len(MEANING), [a, b, float(on), float(count)], [])
    assert int(outcome) == 0
    for name, value in zip(MEANING, states.full().ravel().tolist(), strict=True):
        expected = float(getattr(model, f"out_{name}"))
        # exp and pow of CasADi's own evaluation may be another library's.
        assert (
            value == pytest.approx(expected, rel=1e-15, abs=0.0)
            if name in ("power", "length")
            else (value == expected)
        ), (name, MEANING[name], value, expected)


BRANCHES = """
if self.a > 1.0:
    self._rise(self.b)
elif self.on:
    self.y = -self.y
else:
    self.z += 1.0
for _ in range(3):
    if self.y > 2.0:
        self.y -= 1.0
self.y = self._limited(self.y)
"""
METHODS = """
    def _rise(self, by):
        if by < 0.0:
            return
        self.y += by
        if self.y > 5.0 or self.count > 3:
            self.z, self.y = self.y, 0.0

    def _limited(self, value):
        while value > 3.0:
            return 3.0
        return value
"""


def test_branches_loops_and_early_returns_are_followed(tmp_path):
    path = write(tmp_path, BRANCHES, ("y", "z"), after=METHODS)
    program = trace_component(path, "Model")
    said = check_component(path, load(path), program)
    assert said == "agrees with the Python code over 3000 random steps, largest relative difference 0.0e+00"


def test_paths_are_joined_where_functions_return(tmp_path):
    """20 independent conditions have a million paths; joined after each there are forty."""
    body = "\n".join(f"self._add(self.a > {number}.0)" for number in range(20))
    after = "\n    def _add(self, more):\n        if more:\n            self.y += 1.0\n"
    program = trace_component(write(tmp_path, body, after=after), "Model")
    assert program.paths == 1
    states, _ = program.advance(0.0, 0.1, [0.5], [7.5, 0.0, 0.0, 0.0], [])
    assert float(states) == 8.5


def test_too_many_paths_are_refused_with_the_remedy(tmp_path):
    body = "\n".join(f"if self.a > {number}.0:\n    self.y += 1.0" for number in range(20))
    with pytest.raises(BuildError) as caught:
        trace_component(write(tmp_path, body), "Model")
    assert str(caught.value) == (
        "model.py: native form: more than 2000 paths through one function; put independent conditions into "
        "functions of their own, which are joined where they return"
    )


REFUSALS = [
    ("self.y = {0.0: 1.0}[self.a]", "unhashable type: 'Traced'"),
    (
        "self.y = [1.0, 2.0][self.count]",
        "a number that is only known at run time is needed as an index or a count",
    ),
    ("self.y = math.gamma(self.a)", "math.gamma has no native form"),
    ("self.y = round(self.a, 2)", "round() of a number known at run time only: without digits"),
    (
        "self.y = math.sqrt(complex(self.a).real)",
        "a number that is known only at run time is needed as a plain float",
    ),
]


@pytest.mark.parametrize(("line", "message"), REFUSALS)
def test_code_without_a_native_form_is_refused_with_its_line(tmp_path, line, message):
    path = write(tmp_path, line)
    number = path.read_text().splitlines().index(f"        {line}") + 1
    with pytest.raises(BuildError) as caught:
        trace_component(path, "Model")
    assert (
        str(caught.value) == f"model.py:{number}: native form: {message.replace('only known', 'known only')}"
    )


def test_hidden_memory_is_found(tmp_path):
    path = write(tmp_path, "self.hidden += 1.0\nself.y = self.hidden", extra="self.hidden = 0.0")
    with pytest.raises(BuildError) as caught:
        check_component(path, load(path), trace_component(path, "Model"))
    assert str(caught.value) == (
        "model.py: native form: y differs by 5.0e-01 of its size after the step from 0.0005 s; allowed 1e-09."
        " All memory has to lie in registered variables that can be set"
    )


def test_text_variables_are_refused(tmp_path):
    extra = 'self.text = ""\nself.register_variable(String("text", description="text"))'
    with pytest.raises(BuildError) as caught:
        trace_component(write(tmp_path, "pass", extra=extra), "Model")
    assert str(caught.value) == (
        "model.py: native form: text is a String; allowed: Real, Integer and Boolean inputs, parameters, "
        "outputs and local variables"
    )


def test_a_variable_called_time_is_refused(tmp_path):
    with pytest.raises(BuildError) as caught:
        build_native_fmu(write(tmp_path, "self.time = 1.0", ("time",)), tmp_path / "x.fmu", platforms=[])
    assert str(caught.value) == (
        "model.py: native form: the name time is taken by the simulation time; rename it"
    )
    assert not (tmp_path / "x.fmu").exists()


MESSAGES = """
if self.a > 1.0:
    text = f"{self.instance_name}: a is {self.a!r} ({self.a:.2f}), count {self.count}, on {self.on}"
    self.log(text, Fmi2Status.error)
    return False
if self.b > 1.0:
    self.log("b is large: " + self._how(), Fmi2Status.warning)
if self.b < -1.0:
    raise ValueError(f"b is {self.b!r}")
self.y += 1.0
"""
HOW = """
    def _how(self):
        return f"very, {self.b!r}" if self.b > 100.0 else "somewhat"
"""


@pytest.fixture(scope="module")
def talker(tmp_path_factory):
    """Description and folder of the native form of a component that has much to say."""
    folder = tmp_path_factory.mktemp("talker")
    path = write(folder, MESSAGES, after=HOW)
    path.write_text("from pythonfmu.enums import Fmi2Status\n" + path.read_text())
    fmu = build_native_fmu(path, folder / "x.fmu", platforms=["x86_64-linux"]).path
    return fmpy.read_model_description(str(fmu)), fmpy.extract(str(fmu), unzipdir=str(folder / "x"))


@needs_compiler
@pytest.mark.parametrize("a", [1.5, 1e16, 123456.75, 1e22, 1.0000000000000002, 9007199254740993.0])
def test_messages_are_pythons(talker, a):
    """Numbers in messages are written as Python writes them, by the C code."""
    description, folder = talker
    references = {variable.name: [variable.valueReference] for variable in description.modelVariables}
    reported: list[str] = []
    callbacks = fmi2CallbackFunctions()
    callbacks.logger = fmi2CallbackLoggerTYPE(lambda *message: reported.append(message[4].decode()))
    fmu = FMU2Slave(guid=description.guid, unzipDirectory=folder, modelIdentifier="Model", instanceName="one")
    fmu.instantiate(callbacks=callbacks)
    fmu.setInteger(references["count"], [-3])
    fmu.setBoolean(references["on"], [True])
    fmu.setupExperiment()
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    fmu.setReal(references["a"], [a])
    with pytest.raises(Exception, match="fmi2DoStep failed with status 2"):
        fmu.doStep(0.0, 0.125)
    fmu.setReal(references["a"] + references["b"], [0.0, 2.5])
    assert fmu.getReal(references["y"]) == [0.0]
    fmu.doStep(0.0, 0.125)
    fmu.setReal(references["b"], [1e-5 + a * 1e3])
    fmu.doStep(0.125, 0.125)
    assert fmu.getReal(references["y"]) == [2.0]
    fmu.setReal(references["b"], [-a])
    with pytest.raises(Exception, match="fmi2DoStep failed with status 3"):
        fmu.doStep(0.25, 0.125)
    fmu.freeInstance()
    assert reported == [
        f"one: a is {a!r} ({a:.2f}), count -3, on True",
        "b is large: somewhat",
        f"b is large: very, {1e-5 + a * 1e3!r}",
        f"b is {-a!r}",
    ]


def test_math_constants_stay():
    from orchestrator.translate.traced_library import TracedMath

    assert TracedMath().pi == math.pi and TracedMath().floor(2.5) == 2
