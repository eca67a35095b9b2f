"""What the translator refuses: every whole message, with its line."""

from __future__ import annotations

import re
from pathlib import Path

import build_extra  # noqa: F401
import modelica_bench as bench
import pytest

from orchestrator.base.errors import BuildError
from orchestrator.cli.main import main
from orchestrator.translate.build import build, translate
from orchestrator.translate.complaints import explained
from orchestrator.translate.sources import load_sources

# Body of a model whose first line is line 2 of the file -> the message, {f} standing for the file.
REFUSALS = {
    "redundant equations": (
        "Real x;\nReal y;\nequation\nx + y = 1;\n2*x + 2*y = 2;",
        "{f}:5:1, {f}:6:1: the equations do not determine x, y: they say the same or contradict each other",
    ),
    "delay of itself": (
        "Real x;\nequation\nx = time + delay(x, 0.1);",
        "{f}:4:12: the operand of this delay() depends on the delay's own value ({f}:4:12), a loop if the "
        "delay is zero; put a state between them",
    ),
    "equality of Reals": (
        "Real x;\nequation\nx = noEvent(if time == 1 then 1 else 0);",
        "{f}:4:1: time == 1 compares Reals for equality, which Modelica does not allow; use <= or >=",
    ),
    "start from an input": (
        "input Real u;\nReal x(start=u, fixed=true);\nequation\nder(x) = 1;",
        "{f}:3:6: the start value of x is u; it can depend on parameters only",
    ),
    "fixed algebraic": (
        "Real x(start=1, fixed=true);\nequation\nx = 2;",
        "{f}:2:6: too many initial equations: with them the start value of x must not have fixed=true, since "
        "it is off by 1; drop it",
    ),
    "limit of a limit": (
        "input Real u;\nReal x;\nequation\nx = delay(u, 0.1 + noEvent(abs(u)), u);",
        "{f}:5:5: the limit of a delay is u; it can depend on parameters only",
    ),
    "display unit": (
        'parameter Real p(unit="rad/s", displayUnit="mm") = 1;\nReal x = p*time;\nequation\n',
        "{f}:2:16: displayUnit 'mm' does not fit unit 'rad/s': rad/s [s-1.rad] cannot be converted to mm [m]",
    ),
    "unknown name": (
        "Real x;\nequation\nx = speed;",
        "{f}:4:5: `speed` is declared nowhere in reach; declare it, or correct its name.",
    ),
    "input with an equation": (
        "input Real u = 3;\nReal x;\nequation\nx = u;",
        "{f}:2:12: the input u has a value of its own; give it as start",
    ),
}


def words(error: BaseException) -> str:
    """A message without the lines of the source."""
    return "\n".join(line for line in str(error).splitlines() if not re.match(r" +\d* \| ", line))


@pytest.mark.parametrize("body, message", REFUSALS.values(), ids=REFUSALS)
def test_refusal(body, message, tmp_path):
    path = bench.model_file(tmp_path, f"model Model\n{body}\nend Model;\n")
    with pytest.raises(BuildError) as caught:
        translate(path)
    assert words(caught.value) == message.replace("{f}", str(path))


def refused(path: Path, **options: object) -> str:
    with pytest.raises(BuildError) as caught:
        build(path, path.with_suffix(".fmu"), platforms=(), **options)
    assert not path.with_suffix(".fmu").exists()
    return words(caught.value)


def test_a_derivative_of_an_input_is_refused(tmp_path):
    # The compiler itself gives up on it, with a message that names no file.
    path = bench.model_file(
        tmp_path, "model Model\ninput Real u;\nReal x;\nequation\nx = der(u);\nend Model;\n"
    )
    assert refused(path) == (
        f"{path}:5:5: der() of an input or of a value that jumps is not supported; give the derivative as a "
        "further input"
    )


def test_a_mistake_of_syntax_is_reported_with_its_line(tmp_path):
    # Of the folder that it is given, the compiler only says that it cannot be read.
    path = bench.model_file(tmp_path, "model Model\nReal x;\nequation\nder(x) = -x\nend Model;\n")
    assert refused(path) == f"{path}:5:1: unexpected `end`; is a ; missing before it?"
    path = bench.model_file(tmp_path, "model Model\nReal x, y;\nequation\ny = x\nder(x) = y;\nend Model;\n")
    assert refused(path).startswith(f"{path}:5:1: unexpected `der`")
    path = bench.model_file(tmp_path, "model Model\nReal x = (1 + 2;\nend Model;\n")
    assert refused(path).startswith(f"{path}:2:16: unexpected `;`")


@pytest.mark.parametrize(
    ("declared", "reported"),
    [
        ('output Real flow(unit="m3/s");', ["2:13: `flow`"]),  # here the compiler asks for a ; before it
        ('Real flow;\nReal type "of it";', ["2:6: `flow`", "3:6: `type`"]),  # and here at the model's name
    ],
)
def test_keywords_as_names_are_reported_as_such(tmp_path, declared, reported):
    path = bench.model_file(tmp_path, f"model Model\n{declared}\nend Model;\n")
    remedy = "is a keyword of Modelica and can name no variable; take another name"
    assert refused(path).splitlines() == [f"{path}:{one} {remedy}" for one in reported]


def test_the_standard_library_is_reported_to_be_missing(tmp_path):
    text = "model Model\nModelica.Blocks.Interfaces.RealInput u;\nReal x = u;\nend Model;\n"
    reported = refused(bench.model_file(tmp_path, text))
    assert "The Modelica Standard Library is not found: name its folder by --library" in reported


def test_files_and_names(tmp_path):
    assert refused(tmp_path / "none.mo") == f"{tmp_path}/none.mo: no such file; give the .mo file of a model"
    path = bench.model_file(
        tmp_path, "package P\nmodel A Real x = time; end A;\nmodel B Real y = time; end B;\nend P;\n"
    )
    assert refused(path) == (
        f"{path}: the file defines package P, not one model; name the model to build with --model; "
        "models: P.A, P.B"
    )
    assert refused(path, model="AA") == f"{path}: no model AA; models: P.A, P.B"
    path = bench.model_file(tmp_path, "within Lost;\nmodel M end M;\n")
    assert refused(path) == (
        f"{path}:1: the file says `within Lost`, but its folder is called {tmp_path.name}, not Lost; "
        "put the file into its package or drop the clause"
    )
    path = bench.model_file(tmp_path, 'model M\nReal x = "open;\nend M;\n')
    assert refused(path) == (
        f'{path}:2:10: what begins with this " is not closed by another one; put it behind the text'
    )
    path = bench.model_file(tmp_path, 'model M\nReal x = time;\noutput Real block(unit="K") = x;\nend M;\n')
    assert refused(path) == (
        f"{path}:3: `block` is a keyword of Modelica and names nothing; choose another name, as block_1"
    )
    path = bench.model_file(tmp_path, "model M\nReal x;\n")
    assert refused(path) == f"{path}:1: model M is not closed by its `end`"


def test_options(tmp_path):
    path = bench.model_file(tmp_path, "model M Real x = time; end M;\n")
    output = tmp_path / "M.fmu"
    for options, message in (
        ({"fmi_version": "1.0"}, "FMI version '1.0' is not supported; choose 2.0 or 3.0"),
        ({"compiler": "jmodelica"}, "unknown compiler 'jmodelica'; choose rumoca or omc"),
        (
            {"platforms": ("amiga",)},
            "unknown platform amiga; known: x86_64-linux, x86_64-windows, x86_64-darwin, aarch64-darwin, "
            "or by the folders of FMI 2.0 linux64, win64, darwin64",
        ),
    ):
        with pytest.raises(BuildError) as caught:
            build(path, output, **options)
        assert str(caught.value) == message
    missing = tmp_path / "nowhere" / "M.fmu"
    with pytest.raises(BuildError) as caught:
        build(path, missing)
    assert str(caught.value) == f"{missing}: the folder {missing.parent} does not exist; create it first"


def test_what_flattening_loses_is_noticed(tmp_path):
    """The comparison of source and flat model, on a flat model from which something is missing."""
    from orchestrator.translate.audit import audit_flattened, audit_sources
    from orchestrator.translate.sources import load_sources

    text = 'model M\nReal x;\nequation\nx = delay(time, 0.1);\nassert(x < 3, "far");\nend M;\n'
    path = bench.model_file(tmp_path, text)
    tree = load_sources(path)
    used = audit_sources(tree, "M")
    delay, check = text.index("delay"), text.index("assert")
    audit_flattened(tree, used, {("Model.mo", delay)}, [("Model.mo", check, check + 10)])
    with pytest.raises(BuildError) as caught:
        audit_flattened(tree, used, set(), [])
    assert str(caught.value) == (
        f"{path}:4:5: delay() is lost in flattening; put it into an equation of its own\n"
        f"{path}:5:1: assert() is lost in flattening; put it into the equation section"
    )


def test_an_unknown_part_of_the_representation_is_refused(tmp_path, monkeypatch):
    """A section, attribute or kind of expression that this reader does not know is never passed over."""
    from orchestrator.translate import flatten, reader

    path = bench.model_file(tmp_path, "model M\nReal x;\nequation\nx = time;\nend M;\n")

    def altered(change):
        def run(tree, model):
            flat, files = flatten.flatten(tree, model)
            change(flat)
            return flat, files

        monkeypatch.setattr(reader, "flatten", run)
        return refused(path)

    assert altered(lambda flat: flat.update(clocks=[1])) == (
        f"{path}:1: the compiler's representation has a section 'clocks' that is not known; use rumoca 0.10.2"
    )
    assert altered(lambda flat: flat["variables"]["x"].update(inverse=1)) == (
        f"{path}:2:6: x has the attributes inverse, which are not supported"
    )
    assert altered(lambda flat: flat["equations"][0].update(guard=1)) == (
        f"{path}:4:1: the compiler describes this equation by guard, which is not supported"
    )
    residual = {"Binary": {"op": "Sub", "lhs": {"Quaternion": {}}, "rhs": {"Quaternion": {}}}}
    assert altered(lambda flat: flat["equations"][0].update(residual=residual)) == (
        f"{path}:4:1: expressions of kind Quaternion are not supported"
    )
    assert altered(lambda flat: flat["equations"][0].update(scalar_count=2)) == (
        f"{path}:4:1: the compiler counts 2 scalar equations here, 1 were read"
    )
    monkeypatch.setattr(reader, "flatten", flatten.flatten)
    monkeypatch.setattr(flatten, "version", lambda name: "0.9.13")
    assert refused(path) == (
        "Modelica compiler: rumoca 0.9.13 is installed, its representation is known for 0.10.2 only; run "
        "`pip install rumoca==0.10.2`"
    )


def test_a_machine_without_binaries_is_reported_what_to_build_for(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("platform.machine", lambda: "riscv64")
    monkeypatch.setattr("platform.system", lambda: "Linux")
    model = tmp_path / "M.mo"
    model.write_text("model M\n  output Real y;\nequation\n  y = time;\nend M;\n")
    command = ["build", str(model), "-o", str(tmp_path / "M.fmu")]
    assert main(command) == 1
    reported = capsys.readouterr().err
    assert "binaries cannot be made for this machine, riscv64-linux; name some of x86_64-linux," in reported
    assert main([*command, "--platforms", "none"]) == 0


@pytest.mark.parametrize("arguments", [["none.mo"], ["none.py"], ["none.py", "--form", "native"]])
def test_a_missing_model_is_reported_before_what_a_build_needs(tmp_path, monkeypatch, capsys, arguments):
    def missing():
        raise BuildError("CasADi is not installed")

    for place in ("native_form", "build"):  # native_form takes its own from build
        monkeypatch.setattr(f"orchestrator.translate.{place}.need_casadi", missing)
    file, *more = arguments
    assert main(["build", str(tmp_path / file), *more]) == 1
    assert f"{tmp_path / file}: no such file; give the .mo or .py file" in capsys.readouterr().err


def test_a_message_about_each_file_of_a_library_shows_the_first(tmp_path):
    """So the compiler refuses the parts of a package that lacks its package.mo."""
    (tmp_path / "M.mo").write_text("model M\nend M;\n")
    causes = "; ".join(f"PKG-010 file 'P{k}.mo' has `within Parts;`" for k in range(9))
    shown = explained(load_sources(tmp_path / "M.mo"), "M", f"Failed to load source root: {causes}")
    assert shown.endswith("; and 6 more") and "P2.mo" in shown and "P3.mo" not in shown
