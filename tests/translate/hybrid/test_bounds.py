"""What may not be wrong in silence: subscripts outside their array, assertions at events, in functions."""

from __future__ import annotations

import pytest

pytest.importorskip("rumoca", reason="needs the extra build")

from tests.translate.hybrid.test_hybrid_models import made, run

COUNTER = "Integer k(start=0, fixed=true); equation when sample(0.1, 0.5) then k = pre(k) + 1; end when;"
CASES = {
    "equation": ("Real y, a[3] = {time, 2, 3};", "y = a[k + 1];", 1.1, "M.mo:4: a subscript is outside 1:3"),
    "when": (
        "Real y(start=0, fixed=true), a[3] = {1, 2, 3};", "when sample(0.2, 0.5) then y = a[k]; end when;",
        1.7, "M.mo:4: a subscript is outside 1:3",
    ),
    "relation": (
        "Boolean y; Real a[3] = {time, 2, 3};", "y = a[k + 1] > 1.5;", 1.1,
        "M.mo:4: a subscript is outside 1:3",
    ),
    "static": (
        "constant Integer n = 4; Real y, a[3] = {time, 2, 3};",
        "y = sum(if i <= k + 1 then a[i] else 0 for i in 1:n);", 1.1, "M.mo:4: subscript 4 is outside 1:3",
    ),
    "assigned": (
        "Real a[3](each start=0, each fixed=true);",
        "algorithm when sample(0.2, 0.5) then a[k] := time; end when;", 1.7,
        "M.mo:4: a subscript is outside 1:3",
    ),
    "assertion": (
        "", "when sample(0.2, 0.5) then assert(k < 3, \"k is at the end\"); end when;", 1.2,
        "k is at the end",
    ),
    "assertion in an algorithm": (
        "", "algorithm when sample(0.2, 0.5) then assert(k < 3, \"k is at the end\"); end when;", 1.2,
        "k is at the end",
    ),
    "function": (
        "function f input Real x; output Real y; algorithm y := x; assert(x < 3, \"\"); end f; Boolean y;",
        "y = f(k) > 1;", 1.1, "M.mo:4: an assertion of f() fails",
    ),
    "loop": (
        "function f input Real x[3]; input Integer n; output Real y; protected Integer i; algorithm y := 0; "
        "i := 1; while i <= n loop y := y + x[i]; i := i + 1; end while; end f; Boolean y;",
        "y = f({1, 2, 3}, k) > 1;", 1.6, "M.mo:4: f() has no value",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_the_run_ends_with_the_line_that_has_no_value(tmp_path, case):
    declared, equation, until, message = CASES[case]
    text = f"""model M
  {declared}
  {COUNTER}
  {equation}
end M;
"""
    fmu, said = made(tmp_path, text), []
    logged = lambda *one: said.append(one[-1].decode())  # noqa: E731
    run(fmu, until - 0.05, 0.05, "k", logger=logged)
    assert not [one for one in said if "nan" not in one]
    with pytest.raises(Exception, match="failed with status 3"):
        run(fmu, until + 0.05, 0.05, "k", logger=logged)
    assert any(message in one for one in said)


def test_what_a_condition_keeps_from_being_read_may_be_outside(tmp_path):
    text = f"""model M
  Real y, z, a[3] = {{time, 2, 3}};
  {COUNTER}
  y = if k >= 1 and k <= 3 then a[k] else 0;
  z = if k >= 1 and (k > 3 or a[k] > 2.5) then 1 else 0;
end M;
"""
    found = run(made(tmp_path, text), 2.0, 0.25, "k", "y", "z")
    k = found["k"]
    assert k[-1] == 4
    expected = [{1: t, 2: 2, 3: 3}.get(int(n), 0) for n, t in zip(k, found["time"], strict=True)]
    assert found["y"] == pytest.approx(expected)
    assert list(found["z"]) == [float(n >= 3) for n in k]
