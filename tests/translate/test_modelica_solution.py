"""From Modelica text to solved equations: values, events, delays, parameters, the self-check."""

from __future__ import annotations

import math
from dataclasses import replace

import build_extra  # noqa: F401
import casadi as ca
import modelica_bench as bench
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orchestrator.base.errors import BuildError
from orchestrator.translate.build import translate
from orchestrator.translate.causalise import solve
from orchestrator.translate.flat import Literal, Operation, Reference, Role, render
from orchestrator.translate.generate import generate_c, variable_table
from orchestrator.translate.interpreter import evaluate
from orchestrator.translate.program import Program, build_program
from orchestrator.translate.reader import read_model
from orchestrator.translate.selfcheck import check
from orchestrator.translate.sources import load_sources
from orchestrator.translate.symbolic import symbolic_model


def program(tmp_path, body: str) -> Program:
    tree = load_sources(bench.model_file(tmp_path, f"model Model\n{body}\nend Model;\n"))
    return build_program(solve(symbolic_model(read_model(tree, "Model"))))


def column(result: ca.DM) -> np.ndarray:
    return result.full().ravel()


def values(item: Program, time=0.0, x=(), u=(), d=(), modes=None, **parameters) -> dict[str, float]:
    """Every computed value at a point; modes as the relations say unless given."""
    table = {entry.name: entry for entry in variable_table(item)}
    p = [parameters.get(name, table[name].start or 0.0) for name in item.parameters]
    for name, value in zip(item.dependent, column(item.dependent_parameters(p)), strict=True):
        p[item.parameters.index(name)] = float(value)
    relations = item.model.relations
    if modes is None:
        modes = [0.0] * len(relations)
        for _ in range(5):
            found = column(item.relations(time, x, u, p, d, modes))
            modes = [
                float(r > 0 or (r == 0 and not rel.strict)) for r, rel in zip(found, relations, strict=True)
            ]
    point = (time, x, u, p, d, modes)
    result = dict(zip(item.algebraics, map(float, column(item.algebraic(*point))), strict=True))
    slopes = column(item.derivatives(*point))
    result |= {f"der({name})": float(slope) for name, slope in zip(item.states, slopes, strict=True)}
    result |= dict(zip(item.parameters, p, strict=True))
    operands, times = (column(part) for part in item.delays(*point))
    for number, (operand, delay_time) in enumerate(zip(operands, times, strict=True)):
        result[f"operand {number}"], result[f"time {number}"] = float(operand), float(delay_time)
    return result


def test_algebra_and_functions(tmp_path):
    item = program(
        tmp_path,
        "input Real u;\nReal a;\nReal b;\nReal c;\nReal e;\nequation\n"
        "a = 2^3 - 1/4 + min(u, 1) + max(u, 1);\n"
        "b = sqrt(4) + exp(u) + log(10) + log10(100) + sin(u)*cos(u) + atan2(u, 2) + tanh(u) + asin(u/9);\n"
        "c = noEvent(mod(-7, 3) + rem(-7, 3) + div(-7, 3) + floor(-u)"
        " + ceil(u) + integer(u) + sign(u) + abs(-u));\n"
        "e = smooth(1, if u > 0 then u^2 else -u^2);",
    )
    found = values(item, u=[2.5])
    assert found["a"] == 8 - 0.25 + 1 + 2.5
    expected = 2 + math.exp(2.5) + math.log(10) + 2 + math.sin(2.5) * math.cos(2.5)
    expected += math.atan2(2.5, 2) + math.tanh(2.5) + math.asin(2.5 / 9)
    assert found["b"] == pytest.approx(expected, rel=1e-15)
    assert found["c"] == 2 - 1 - 2 - 3 + 3 + 2 + 1 + 2.5
    assert found["e"] == 2.5**2


def test_linear_loops_are_solved_with_their_conditions(tmp_path):
    item = program(
        tmp_path,
        "parameter Real k = 3;\ninput Real u;\nReal x;\nReal y;\nReal z;\nequation\nx + k*y = u;\n"
        "y - x = if u > 1 then 1 else z;\nz = x + 2*y;",
    )
    for u in (0.5, 2.0):
        found = values(item, u=[u], k=4.0)
        x, y, z = found["x"], found["y"], found["z"]
        assert x + 4 * y == pytest.approx(u) and z == pytest.approx(x + 2 * y)
        assert y - x == pytest.approx(1 if u > 1 else z)


def test_arrays_loops_and_components(tmp_path):
    item = program(
        tmp_path,
        "model Part parameter Real k = 1; input Real u; output Real y; equation y = k*u; end Part;\n"
        "parameter Integer n = 3;\nparameter Real A[2, 2] = {{0, 1}, {-4, 0}};\n"
        "Real v[2](start={1, 2}, each fixed=true);\n"
        "Real w[n];\nPart part[2](k={5, 7});\nReal s;\nequation\n"
        "der(v) = A*v;\nfor i in 1:n loop\nw[i] = i*time;\n"
        "end for;\nfor i in 1:2 loop\npart[i].u = v[i];\nend for;\ns = sum(w) + v*v + A[2, 1] + size(w, 1);",
    )
    found = values(item, time=2.0, x=[1.0, 2.0])
    assert (found["der(v[1])"], found["der(v[2])"]) == (2.0, -4.0)
    assert [found[f"w[{i}]"] for i in (1, 2, 3)] == [2.0, 4.0, 6.0]
    assert (found["part[1].y"], found["part[2].y"]) == (5.0, 14.0)
    assert found["s"] == 12 + 5 - 4 + 3
    # The size of an array is built in: nobody may set it.
    table = {entry.name: entry for entry in variable_table(item)}
    assert not table["n"].settable and table["part[1].k"].settable


def test_loops_that_the_compiler_keeps_are_unrolled(tmp_path):
    """It gives der(x[3]) = 0 for all but the first equations of the second and third loop."""
    text = (
        "parameter Integer n = 5;\nparameter Integer m = 2;\ninput Real u;\nReal x[n](each start=0);\n"
        "Real f[n];\nReal c[m, 3](each start=0);\noutput Real y;\nequation\nf[1] = u - x[1];\n"
        "for i in 2:n loop\nf[i] = 2*(x[i-1] - x[i]);\nend for;\n"
        "for i in 1:n-1 loop\nder(x[i]) = f[i] - f[i+1];\nend for;\nder(x[n]) = f[n];\n"
        "for i in 1:m loop\nfor j in 1:3 loop\nder(c[i, j]) = i*u - 10*j*c[i, j];\nend for;\nend for;\n"
        "y = x[n - m + 1];"
    )
    item = program(tmp_path, text)
    x, c = np.array([5.0, 7.0, 1.0, -2.0, 4.0]), np.arange(6.0) + 1
    found = values(item, u=[3.0], x=[*x, *c])
    f = np.array([3.0 - x[0], *(2 * (x[:-1] - x[1:]))])
    assert [found[f"der(x[{i + 1}])"] for i in range(5)] == pytest.approx([*(f[:-1] - f[1:]), f[-1]])
    expected = [i * 3.0 - 10 * j * c[3 * (i - 1) + j - 1] for i in (1, 2) for j in (1, 2, 3)]
    assert [found[f"der(c[{i},{j}])"] for i in (1, 2) for j in (1, 2, 3)] == expected
    assert found["y"] == -2.0
    # Both sizes went into subscripts.
    assert {entry.name for entry in variable_table(item) if entry.kind == "PARAMETER"} == {"n", "m"}
    assert not any(entry.settable for entry in variable_table(item) if entry.kind == "PARAMETER")
    lines = {equation.location.line for equation in item.model.symbols.flat.equations}
    assert lines == {10, 12, 15, 17, 20, 23}


def test_relations_become_modes_but_not_within_no_event(tmp_path):
    item = program(
        tmp_path,
        "parameter Real p = 1;\ninput Real u;\nReal a;\nReal b;\nReal c;\nReal d;\nequation\n"
        "a = if u > 2 then 1 else 0;\nb = noEvent(if u > 2 then 1 else 0);\nc = if p > 0 then 1 else 0;\n"
        "d = if 2 < u or time >= 3 then 1 else 0;",
    )
    relations = item.model.relations
    assert [(str(rel.expression), rel.strict) for rel in relations] == [("(u-2)", True), ("(time-3)", False)]
    frozen = values(item, u=[5.0], modes=[0.0, 0.0])
    assert (frozen["a"], frozen["b"], frozen["c"], frozen["d"]) == (0, 1, 1, 0)
    assert values(item, u=[5.0])["d"] == 1 and values(item, u=[0.0], time=3.0)["d"] == 1


def test_abs_and_sign_raise_events(tmp_path):
    item = program(tmp_path, "input Real u;\nReal a;\nReal b;\nequation\na = abs(u);\nb = sign(u);")
    assert len(item.model.relations) == 3
    for u, a, b in ((-2.0, 2.0, -1.0), (0.0, 0.0, 0.0), (3.0, 3.0, 1.0)):
        assert (values(item, u=[u])["a"], values(item, u=[u])["b"]) == (a, b)


def test_delays_are_ordered_and_bounded(tmp_path):
    item = program(
        tmp_path,
        "parameter Real tau = 0;\ninput Real u;\nReal y;\nReal z;\nequation\n"
        "y = delay(2*z, tau + abs(z), 3);\n"
        "z = delay(u, tau) + delay(u, 0.5);",
    )
    # y's operand reads what z's delays give, so they come first.
    found = values(item, u=[4.0], d=[1.0, 2.0, 9.0], tau=0.25)
    assert (found["y"], found["z"]) == (9.0, 3.0)
    assert [found[f"operand {i}"] for i in range(3)] == [4.0, 4.0, 6.0]
    assert [found[f"time {i}"] for i in range(3)] == [0.25, 0.5, 3.25]
    assert item.bounded == (0, 1, 2)
    assert column(item.delay_maxima([0.25])).tolist() == [0.25, 0.5, 3.0]
    # The limit is checked while the model runs.
    (limit,) = item.model.symbols.flat.assertions
    assert limit.error and limit.message == "delay time tau + abs(z) exceeds its limit 3"


def test_a_varying_delay_without_limit_is_unbounded(tmp_path):
    item = program(tmp_path, "input Real u;\nReal y;\nequation\ny = delay(u, 0.1 + noEvent(abs(u)));")
    assert item.bounded == ()
    assert "maximum[0] = INFINITY;" in generate_c(item, "Model")


def test_parameters_and_start_values(tmp_path):
    item = program(
        tmp_path,
        "constant Real c = 3;\nparameter Real p = 2*c;\nparameter Real q = p + r;\nparameter Real r = 10*p;\n"
        "final parameter Real f = 4;\nparameter Boolean on = true;\nparameter Integer n = 2;\n"
        "Real x(start=q, fixed=true);\nReal y(start=1, fixed=true);\nequation\n"
        "der(x) = if on then f else n;\nder(y) = if n == 2 then 1 else c;\n"
        "protected\nparameter Real hidden = 5;",
    )
    assert item.dependent == ("r", "q") and item.started == ("x",)
    p = [{"c": 3.0, "p": 6.0, "r": 60.0, "q": 66.0}.get(name, 0.0) for name in item.parameters]
    assert column(item.dependent_parameters(p)).tolist() == [60.0, 66.0]
    assert column(item.dependent_starts(p)).tolist() == [66.0]
    settable = {entry.name for entry in variable_table(item) if entry.settable}
    assert settable == {"p", "on", "n", "y"}
    assert (values(item)["der(x)"], values(item)["der(y)"]) == (4, 1)
    assert (values(item, on=0.0)["der(x)"], values(item, n=3)["der(y)"]) == (2, 3)


def test_a_parameter_that_chooses_equations_cannot_be_set(tmp_path):
    """The compiler has taken one of the branches for good."""
    text = (
        "parameter Boolean direct = base;\nparameter Boolean base = true;\nparameter Real p = 1;\n"
        "Real x;\nReal y;\nequation\nif direct then\nx = p;\ny = 2;\nelse\nx + y = 3;\nx = y;\nend if;"
    )
    item = program(tmp_path, text)
    assert item.model.symbols.flat.structural == ("direct", "base")
    assert {entry.name for entry in variable_table(item) if entry.settable} == {"p"}
    _, report = translate(tmp_path / "Model.mo")
    assert "built in, since they decide which equations there are: direct, base" in report.notes


def test_nested_models_keep_their_ports_inside():
    tree = load_sources(bench.ROOT / "modelica" / "DockingHIL" / "Examples" / "UncompensatedDocking.mo")
    flat = read_model(tree, tree.model_name(None))
    assert flat.name == "DockingHIL.Examples.UncompensatedDocking"
    roles = {variable.name: variable.role for variable in flat.variables}
    assert roles["robot.command"] is Role.LOCAL and roles["position"] is Role.OUTPUT
    equations = [f"{render(e.left)} = {render(e.right)}" for e in flat.equations]
    assert "robot.delayed_command = delay(robot.command, robot.tau_m)" in equations
    assert flat.experiment == {"StopTime": 3.0, "Interval": 1e-4, "Tolerance": 1e-8}
    lines = [str(e.location) for e in flat.equations]
    assert sum("DockingHIL/RobotResponse.mo:15:" in line for line in lines) == 1


def test_delay_is_a_name_like_any_other(tmp_path):
    item = program(
        tmp_path,
        'parameter Real delay(unit="s") = 2 "not delay(x, y)";\ninput Real u;\nReal y; // delay(u, 1)\n'
        "equation\n"
        "y = delay*u;",
    )
    assert not item.model.delays and values(item, u=[3.0])["y"] == 6.0


# Self-check ------------------------------------------------------------------------------------------------


def test_the_self_check_evaluates_every_equation(tmp_path):
    item = program(tmp_path, "input Real u;\nReal y;\nequation\ny = if u > 0 then delay(u, 0.1) else 2*u;")
    report = check(item)
    assert report.points == 40 and report.largest_residual == 0.0


@pytest.mark.parametrize("factor", [1 + 1e-8, -1.0])
def test_a_corrupted_solution_fails_the_self_check(tmp_path, factor):
    item = program(
        tmp_path, "input Real u;\nReal x(start=0);\nReal y;\nequation\nder(x) = u - x;\ny = u + 2*x;"
    )
    solved = item.model
    for group in ("algebraics", "derivatives"):
        wrong = replace(solved, **{group: {k: factor * v for k, v in getattr(solved, group).items()}})
        with pytest.raises(BuildError, match="self-check: the solution does not satisfy") as caught:
            check(build_program(wrong))
        line = 7 if group == "algebraics" else 6
        assert str(caught.value).startswith(f"{tmp_path}/Model.mo:{line}:")


def test_two_symbols_of_one_name_fail_the_self_check(tmp_path):
    """The trap of CasADi: symbols are distinguished by identity, names are only printed."""
    item = program(tmp_path, "input Real u;\nReal y;\nequation\ny = 2*u;")
    impostor = ca.SX.sym("u")
    solved = replace(item.model, algebraics={"y": 2 * impostor})
    with pytest.raises((BuildError, RuntimeError)):
        check(build_program(solved))


def test_a_corrupted_relation_or_delay_fails_the_self_check(tmp_path):
    item = program(tmp_path, "input Real u;\nReal y;\nequation\ny = if u > 0 then delay(u, 0.1) else 2;")
    (relation,), (delay,) = item.model.relations, item.model.delays
    for wrong in (
        replace(item.model, relations=[replace(relation, expression=-relation.expression)]),
        replace(item.model, delays=[replace(delay, operand=delay.operand + 1e-3)]),
        replace(item.model, delays=[replace(delay, time=2 * delay.time)]),
    ):
        with pytest.raises(BuildError, match="self-check"):
            check(build_program(wrong))


def test_a_model_without_values_cannot_be_checked(tmp_path):
    item = program(tmp_path, "Real y;\nequation\ny = log(-1 - time^2);")
    with pytest.raises(BuildError) as caught:
        check(item)
    assert str(caught.value).startswith(
        "Model: the solution could be checked at 0 of 2000 random points only"
    )


# Derivatives -----------------------------------------------------------------------------------------------


@settings(max_examples=40, deadline=None)
@given(st.lists(st.floats(-3, 3), min_size=7, max_size=7))
def test_the_tangent_is_the_slope(tangent_model, numbers):
    item = tangent_model
    u, x, d, p, du, dx, dd = numbers
    # Frozen modes: the tangent belongs to one side of an event.
    point, seed = (0.5, [x], [u], [p], [d, 2 * d], [1.0]), (0.1, [dx], [du], [0.3], [dd, -dd])

    def moved(h: float) -> np.ndarray:
        at = [np.add(one, h * np.array(other)) for one, other in zip(point[:5], seed, strict=True)]
        parts = (
            item.derivatives(*at, point[5]),
            item.algebraic(*at, point[5]),
            item.delays(*at, point[5])[0],
        )
        return np.concatenate([column(part) for part in parts])

    tangent = np.concatenate([column(part) for part in item.tangent(*point, *seed)])
    h = 1e-4
    # Five points: the error of the difference is below h^4 times the fifth derivative.
    slope = (8 * (moved(h) - moved(-h)) - (moved(2 * h) - moved(-2 * h))) / (12 * h)
    np.testing.assert_allclose(tangent, slope, rtol=1e-7, atol=1e-7)


@pytest.fixture(scope="module")
def tangent_model(tmp_path_factory):
    return program(
        tmp_path_factory.mktemp("tangent"),
        "parameter Real p = 2;\ninput Real u;\nReal x(start=0);\nReal y;\nReal z;\nequation\n"
        "der(x) = p*sin(x*u) - delay(x*y, 0.2);\ny + z = (if u > 0 then x^2*u else time) + delay(u, 0.1);\n"
        "y - 2*z = exp(u/3);",
    )


def test_a_branch_that_is_not_taken_has_no_slope(tmp_path):
    item = program(
        tmp_path,
        "parameter Real p = 0;\ninput Real u;\nReal y;\nequation\n"
        "y = noEvent(if p > 0 then p*floor(u/p + 0.5) else u);",
    )
    _, slope, _ = item.tangent(0, [], [3.0], [0.0], [], [], 0, [], [2.0], [1.0], [])
    assert float(slope) == 2.0


# Text ------------------------------------------------------------------------------------------------------


NAMES = ("a", "b", "c")
NODES = st.recursive(
    st.one_of(st.sampled_from(NAMES).map(Reference), st.integers(1, 9).map(lambda i: Literal(float(i)))),
    lambda inner: st.one_of(
        st.builds(lambda n, x, y: Operation(n, (x, y)), st.sampled_from("+-*/"), inner, inner),
        st.builds(lambda x: Operation("negate", (x,)), inner),
        st.builds(lambda x: Operation("^", (x, Literal(2.0))), inner),
    ),
    max_leaves=8,
)


@given(NODES)
def test_rendered_expressions_mean_the_same(node):
    point = {"a": 1.7, "b": -2.3, "c": 0.6}
    try:
        expected = evaluate(node, point)
    except ArithmeticError:
        return
    assert eval(render(node).replace("^", "**"), {}, point) == pytest.approx(expected, rel=1e-9, abs=1e-12)
