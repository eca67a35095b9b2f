"""Which names are one: those that differ in case only are not (Modelica Language Specification 2.3.1)."""

from __future__ import annotations

import build_extra  # noqa: F401
import fmpy
import modelica_bench as bench
import pytest

from orchestrator.base.errors import BuildError
from orchestrator.translate.build import build
from orchestrator.translate.sources import load_sources

HERE = {"linux64": "x86_64-linux", "win64": "x86_64-windows", "darwin64": "x86_64-darwin"}.get(
    fmpy.platform, ""
)


def built(tmp_path, text: str, model: str | None = None):
    path = bench.model_file(tmp_path, text)
    build(path, tmp_path / "Model.fmu", model=model, platforms=(HERE,))
    return tmp_path / "Model.fmu"


@pytest.mark.parametrize(
    ("small", "capital"),
    [
        ("parameter Integer n = 3;", "constant Integer N = 4;"),
        ("constant Integer n = 3;", "constant Integer N = 4;"),
        ("parameter Integer n = 3;", "parameter Integer N = 4;"),
    ],
)
def test_ranges_and_dimensions_take_the_name_that_is_written(tmp_path, small, capital):
    text = (
        f"model Model\n  input Real u(start=1);\n  {small}\n  {capital}\n  output Real z;\n"
        "  output Real a[N];\n  output Real late;\nequation\n  z = sum(i*u for i in 1:N);\n"
        "  for i in 1:N loop\n    a[i] = (i + n)*u;\n  end for;\n"
        '  late = delay(N*u, 0.1);\n  assert(u > -1, "too low");\nend Model;\n'
    )
    with bench.instance(built(tmp_path, text), u=1.0) as item:
        names = [f"a[{number}]" for number in range(1, 5)]
        assert [name for name in item.variables if name.startswith("a[")] == names
        item.set({"u": 2.0})
        item.step(0.05)
        assert item.get("z", *names) == [20.0, 8.0, 10.0, 12.0, 14.0]


def test_names_of_components_in_a_package(tmp_path):
    text = (
        "package Model\n"
        "  model Part\n    parameter Integer n = 2;\n    parameter Real m = 5;\n    output Real v[n];\n"
        "  equation\n    for i in 1:n loop\n      v[i] = i*m;\n    end for;\n  end Part;\n"
        "  model Whole\n    constant Integer N = 3;\n    parameter Real M = 7;\n    Part p(n=N, m=M);\n"
        "    output Real w;\n  equation\n    w = p.v[N];\n  end Whole;\nend Model;\n"
    )
    with bench.instance(built(tmp_path, text, "Whole")) as item:
        item.step(0.1)
        assert item.get("w") == [21.0]
        assert {"M", "w"} <= set(item.variables)


def test_messages_have_the_names_and_lines_of_the_source(tmp_path):
    path = bench.model_file(
        tmp_path, "model Model\n  parameter Real n = 1;\n  Real N;\nequation\n  N = n*missing;\nend Model;\n"
    )
    with pytest.raises(BuildError) as caught:
        build(path, tmp_path / "Model.fmu", platforms=())
    assert f"{path}:5:9: `missing`" in str(caught.value)
    assert "case1" not in str(caught.value)


def test_offsets_in_renamed_sources_lead_back(tmp_path):
    text = "model Model\n  Real n;\n  Real N;\nequation\n  n = N; N = delay(n, 1);\nend Model;\n"
    tree = load_sources(bench.model_file(tmp_path, text))
    assert tree.renamed == {"n": "n_case1"}
    with tree.marked_copy() as folder:
        seen = (folder / "Model.mo").read_text(encoding="utf-8")
    for word in ("N;", "equation", "dE1ay", "end Model"):
        original = text.index(word.replace("dE1ay", "delay"))
        assert tree.restore_offset("Model.mo", seen.index(word)) == original


def pipes(parts: str, more: str = "") -> str:
    return (
        "model Model\n"
        "  package Water\n    constant Real c = 2;\n  end Water;\n"
        "  package Oil\n    extends Water(c = 3);\n  end Oil;\n"
        "  package Own\n    extends Water;\n  end Own;\n"
        "  model Pipe\n    replaceable package Medium = Water;\n    input Real u;\n    output Real y;\n"
        f"  equation\n    y = Medium.c*u;\n  end Pipe;\n{more}"
        f"  input Real u(start=1);\n{parts}  output Real y = a.y + 10*b.y;\n"
        "equation\n  a.u = u;\n  b.u = u;\nend Model;\n"
    )


OIL = "(redeclare package Medium = Oil)"


@pytest.mark.parametrize(
    ("parts", "value"),
    [
        (f"  Pipe a{OIL};\n  Pipe b{OIL};\n", 33.0),
        (f"  Pipe a{OIL}, b(redeclare package Medium = Own);\n", 23.0),
        ("  Pipe a, b;\n", 22.0),
    ],
)
def test_packages_that_modifications_replace_are_no_classes_of_the_model(tmp_path, parts, value):
    with bench.instance(built(tmp_path, pipes(parts)), u=1.0) as item:
        item.step(0.1)
        assert item.get("y") == [value]


@pytest.mark.parametrize(
    ("parts", "more"),
    [
        (f"  Pipe a{OIL};\n  Pipe b;\n", ""),
        (f"  Pipe a{OIL}, b(redeclare package Medium = Water);\n", ""),
        ("  Other a;\n  Pipe b;\n", f"  model Other = Pipe{OIL};\n"),
        ("  Other a;\n  Pipe b;\n", f"  model Other\n    extends Pipe{OIL};\n  end Other;\n"),
        (
            "  Other a;\n  Pipe b;\n",
            "  model Other\n    extends Pipe;\n    redeclare package Medium = Oil;\n  end Other;\n",
        ),
    ],
)
def test_a_package_that_one_component_replaces_and_another_keeps(tmp_path, parts, more):
    """The compiler alone would take one for both, in silence."""
    with bench.instance(built(tmp_path, pipes(parts, more)), u=1.0) as item:
        item.step(0.1)
        assert item.get("y") == [23.0]
