"""`orchestrator build --check`: every fault of a model at once, without a build."""

from __future__ import annotations

import itertools
import json
import math
from types import SimpleNamespace

import build_extra  # noqa: F401
import modelica_bench as bench
import pytest

pytest.importorskip("rumoca", reason="needs the extra build")

from orchestrator.cli.main import main
from orchestrator.translate import check
from orchestrator.translate.build import translate
from orchestrator.translate.check import check_model

# Eight faults of six kinds: line and column of each, and words of its message.
FAULTY = """model Model
  parameter Real m(unit="kg") = 1;
  Real x(unit="m", start=1, fixed=true), v(unit="m/s");
  Real y, z
  Integer n;
  Boolean b;
equation
  der(x) = v + lost;
  v = m*x;
  y = missing*2;
  n = 2.5;
  b = x + 1;
  z = 1
  when x > 2 then
    reinit(y, 0);
  end when;
end Model;
"""
EXPECTED = [
    (5, 3, "is a ; missing before it"),
    (8, 16, "`lost` is declared nowhere"),
    (9, 3, "the sides of this equation are in m.s-1 and kg.m"),
    (10, 7, "`missing` is declared nowhere"),
    (11, 3, "unlike types"),
    (12, 3, "the types Boolean and Real do not fit"),
    (14, 3, "is a ; missing before it"),
    (15, 5, "reinit() of y, which is no state"),
]


@pytest.fixture(autouse=True)
def no_hurry(monkeypatch):
    """What is found must not depend on how busy a test's machine is."""
    monkeypatch.setattr(check, "_LONGEST", math.inf)


def found(path) -> list[tuple[int, int, str]]:
    return [(*one.fault.places[0][1:], one.fault.what) for one in check_model(path).findings]


def test_all_faults_are_reported_at_once(tmp_path):
    reported = found(bench.model_file(tmp_path, FAULTY))
    assert [one[:2] for one in reported] == [one[:2] for one in EXPECTED]
    for (_, _, what), (_, _, words) in zip(reported, EXPECTED, strict=True):
        assert words in what


def test_a_repaired_model_has_none_and_translates(tmp_path):
    """What is reported can be mended one by one, and then the build takes the model."""
    text = (
        FAULTY.replace("y, z\n", "y(start=0, fixed=true), z;\n").replace("lost", "0").replace("m*x", "x/tau")
    )
    text = (
        text.replace("missing*2", "der(y) - 1").replace("2.5", "integer(x)").replace("b = x + 1", "b = x > 1")
    )
    text = text.replace("z = 1\n", "z = 1;\n").replace(
        "Real y", 'parameter Real tau(unit="s") = 2;\n  Real y'
    )
    path = bench.model_file(tmp_path, text)
    assert found(path) == []
    translate(path)


@pytest.mark.parametrize(
    ("body", "kind", "places"),
    [
        ("Real x(start=1, fixed=true), y, z;\nequation\nder(x) = -x;\ny = x;", "balance", [(2, 33)]),
        ("Real x, y, z;\nequation\nx = 1;", "balance", [(2, 9), (2, 12)]),
        (
            "Real x(start=1, fixed=true), y(start=2, fixed=true);\ninitial equation\nx = 2;\ny = 3;\n"
            "equation\nder(x) = -x;\nder(y) = -y;",
            "balance",
            [(2, 6), (2, 30)],
        ),
        ('Real x(unit="m") = 1;\nReal s = sin(x);\nReal t(unit="h") = x;', "units", [(3, 14), (4, 20)]),
        ('Real x(unit="metres") = 1;', "units", [(2, 6)]),
        (
            'function f\ninput Real u;\noutput Real y;\nexternal "C" y = g(u);\nend f;\n'
            "Real a = f(time);\nReal b = f(2*time);",
            "unsupported",
            [(7, 10), (8, 10)],
        ),
    ],
    ids=["one too few", "two too few", "start", "units", "unknown unit", "external functions"],
)
def test_kinds_and_places(tmp_path, body, kind, places):
    report = check_model(bench.model_file(tmp_path, f"model Model\n{body}\nend Model;\n"))
    assert {one.kind for one in report.findings} == {kind}
    assert [one.fault.places[0][1:] for one in report.findings] == places


def test_units_of_sound_equations_fit(tmp_path):
    """Angles, numbers that convert, powers and roots, and arrays do not give false alarms."""
    text = """model Model
  parameter Real r(unit="m") = 2, g(unit="m/s2") = 9.81, none = 3;
  Real phi(unit="rad", start=0, fixed=true), w(unit="rad/s"), v(unit="m/s"), s(unit="mm"), f(unit="Hz");
  Real height(unit="m") = r*(1 - cos(phi)), speed(unit="m/s") = sqrt(2*g*abs(height)) + none;
  Real e(unit="m2/s2") = v^2/2 + g*height, both[2](each unit="m") = {r, 2*height};
equation
  der(phi) = w;
  v = w*r;
  s = 1000*r;
  w = 2*3.14*f + (if time > 1 then 1 else 2);
  f = 1/(1 + time);
end Model;
"""
    assert found(bench.model_file(tmp_path, text)) == []


def test_the_command_tells_exit_code_and_json(tmp_path, capsys):
    path = bench.model_file(tmp_path, FAULTY)
    assert main(["build", str(path), "--check"]) == 1
    text = capsys.readouterr().out
    assert f"{path}:8:16: `lost`" in text and "     8 |   der(x) = v + lost;" in text
    assert f"{path}: 8 problems" in text
    assert main(["build", str(path), "--check", "--json"]) == 1
    reported = json.loads(capsys.readouterr().out)
    assert reported["exit_code"] == 1 and len(reported["problems"]) == 8
    assert reported["problems"][0]["places"] == [{"file": str(path), "line": 5, "column": 3}]
    assert reported["unchecked"] == ["the number of equations and the initialisation"]
    assert not list(tmp_path.glob("*.fmu"))
    assert main(["build", str(path), "-o", str(tmp_path / "M.fmu"), "--json"]) == 1
    problems = json.loads(capsys.readouterr().out)["error"]["problems"]
    assert problems[0]["place"] == f"{path}:5:3" and "is a ; missing" in problems[0]["what"]
    sound = bench.model_file(tmp_path, "model Sound\n  Real x = time;\nend Sound;\n", "Sound.mo")
    assert main(["build", str(sound), "--check"]) == 0
    assert "no problems" in capsys.readouterr().out


def test_a_check_begins_no_try_after_its_time(tmp_path, monkeypatch):
    """Each look at the clock takes half a second here."""
    lines = "".join(f"  Real x{n} = {n}\n" for n in range(20))
    path = bench.model_file(tmp_path, f"model Model\n{lines}end Model;\n")
    assert len(check_model(path).findings) == 20
    clock = itertools.count(step=0.5)
    monkeypatch.setattr(check, "_LONGEST", 1.5)
    monkeypatch.setattr(check, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    report = check_model(path)
    assert 1 <= len(report.findings) <= 4
    assert report.unchecked
    assert next(clock) <= 3.0
