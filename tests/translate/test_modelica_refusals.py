"""What the translator refuses: every whole message, with its line."""

from __future__ import annotations

from pathlib import Path

import build_extra  # noqa: F401
import modelica_bench as bench
import pytest

from orchestrator.base.errors import BuildError
from orchestrator.cli.main import main
from orchestrator.translate.build import build, translate

WHEN = "write it as an if-expression of continuous variables, or move it to a Python FMU"
EVENTS = "discrete-time behaviour belongs in a Python FMU"

# Body of a model whose first line is line 2 of the file -> the message, {f} standing for the file.
REFUSALS = {
    "when": (
        "Real x(start=1, fixed=true);\nequation\nder(x) = -x;\nwhen x < 0.5 then\nreinit(x, 1);\nend when;",
        f"{{f}}:5: `when` is not supported; {WHEN}\n"
        "{f}:6: reinit() is not supported; a state that jumps belongs in a Python FMU",
    ),
    "algorithm": (
        "Real x;\nalgorithm\nx := time;",
        "{f}:3: `algorithm` is not supported; write equations instead",
    ),
    "initial equation": (
        "Real x;\ninitial equation\nx = 1;\nequation\nder(x) = -x;",
        "{f}:3: `initial equation` is not supported; give start values with fixed=true instead",
    ),
    "sampled": (
        "Real x;\nequation\nx = if sample(0, 0.1) then 1 else 0;",
        f"{{f}}:4: sample() is not supported; {EVENTS}",
    ),
    "pre and edge": (
        "Boolean b;\nBoolean c;\nequation\nb = edge(c);\nc = pre(b);",
        f"{{f}}:5: edge() is not supported; {EVENTS}\n{{f}}:6: pre() is not supported; {EVENTS}",
    ),
    "initial()": (
        "Real x;\nequation\nx = if initial() then 1 else 0;",
        "{f}:4: initial() is not supported; give start values with fixed=true",
    ),
    "terminate": (
        'Real x;\nequation\nx = time;\nwhen x > 1 then terminate("end"); end when;',
        f"{{f}}:5: `when` is not supported; {WHEN}\n"
        "{f}:5: terminate() is not supported; stop from the importer instead",
    ),
    "conditional component": (
        "parameter Boolean with_part = true;\nmodel Part Real x = time; end Part;\n"
        "Part part if with_part;\nequation\n",
        "{f}:4: a conditional component is not supported; make two models of it, one with the component and "
        "one without",
    ),
    "assert in an if-equation": (
        'Real x;\nequation\nif time > 1 then\nx = 1;\nassert(x < 2, "far");\nelse\nx = 2;\nend if;',
        "{f}:6: assert() within an if-equation is not supported; put it into the equation section and the "
        "condition into its first argument",
    ),
    "function": (
        "function square input Real u; output Real y; algorithm y := u*u; end square;\nReal x;\nequation\n"
        "x = square(time);",
        "{f}:5: the function square is not supported; only built-in functions are, write its formula instead",
    ),
    "nonlinear equation": (
        "Real x;\nequation\nx^3 + x = time;",
        "{f}:4: the equation is nonlinear in x, which is not supported; write it as x = expression",
    ),
    "nonlinear condition": (
        "Real x;\nequation\nx = noEvent(if x > 0 then 1 else 2) + time;",
        "{f}:4: the equation is nonlinear in x, which is not supported; write it as x = expression",
    ),
    "nonlinear loop": (
        "Real x;\nReal y;\nequation\nx = sin(y) + time;\ny = x + 1;",
        "{f}:5: nonlinear algebraic loop of x, y, which is not supported\n"
        "  {f}:5: x depends on y\n"
        "  {f}:6: y depends on x\n"
        "  Break it with a state (a small time constant) or a delay().",
    ),
    "redundant equations": (
        "Real x;\nReal y;\nequation\nx + y = 1;\n2*x + 2*y = 2;",
        "{f}:5, {f}:6: the equations do not determine x, y: they say the same or contradict each other",
    ),
    "higher index": (
        "Real x;\nReal y;\nequation\nder(x) = y;\nx = sin(time);",
        "{f}:6: the model is structurally singular: no equation is left to determine der(x); an equation "
        "between states or inputs alone fixes no unknown (index reduction is not supported)",
    ),
    "delay of itself": (
        "Real x;\nequation\nx = time + delay(x, 0.1);",
        "{f}:4: the operand of this delay() depends on the delay's own value ({f}:4), a loop if the delay is "
        "zero; put a state between them",
    ),
    "floor": (
        "Real x;\nequation\nx = floor(10*time);",
        "{f}:4: floor() of a variable raises events, which is not supported; write noEvent(floor(10 * time))",
    ),
    "equality of Reals": (
        "Real x;\nequation\nx = noEvent(if time == 1 then 1 else 0);",
        "{f}:4: time == 1 compares Reals for equality, which Modelica does not allow; use <= or >=",
    ),
    "subscript": (
        "input Integer i;\nReal w[2] = {1, time};\nReal x;\nequation\nx = w[i];",
        "{f}:6: a subscript or size has to be an Integer of constants and parameters, got i",
    ),
    "string": (
        'parameter String name = "a";\nReal x = time;\nequation\n',
        "{f}:2: name has the type String; only Real, Integer and Boolean are supported",
    ),
    "enumeration": (
        "type Mode = enumeration(off, on);\nparameter Mode mode = Mode.on;\nReal x = time;\nequation\n",
        "{f}:3: mode has the type Mode; only Real, Integer and Boolean are supported, use an Integer for an "
        "enumeration",
    ),
    "start from an input": (
        "input Real u;\nReal x(start=u, fixed=true);\nequation\nder(x) = 1;",
        "{f}:3: the start value of x is u; it can depend on parameters only",
    ),
    "fixed algebraic": (
        "Real x(start=1, fixed=true);\nequation\nx = time;",
        "{f}:2: x has fixed=true but is no state; drop it, or write the equation so that der() of it appears",
    ),
    "free parameter": (
        "parameter Real p(fixed=false);\nReal x;\nequation\nx = p;",
        "{f}:2: p has fixed=false, which needs initial equations; give it a value",
    ),
    "limit of a limit": (
        "input Real u;\nReal x;\nequation\nx = delay(u, 0.1 + noEvent(abs(u)), u);",
        "{f}:5: the limit of a delay is u; it can depend on parameters only",
    ),
    "display unit": (
        'parameter Real p(unit="rad/s", displayUnit="mm") = 1;\nReal x = p*time;\nequation\n',
        "{f}:2: displayUnit 'mm' does not fit unit 'rad/s': rad/s [s-1.rad] cannot be converted to mm [m]",
    ),
    "unknown name": (
        "Real x;\nequation\nx = speed;",
        "{f}:1: the Modelica compiler refuses Model\n"
        "  Model could not be compiled: unresolved component reference: 'speed'\n"
        "  Related failures (showing 1):\n"
        "  - <resolve> [Resolve]: unresolved component reference: 'speed'\n"
        "  {f}:4: speed",
    ),
    "input with an equation": (
        "input Real u = 3;\nReal x;\nequation\nx = u;",
        "{f}:2: the input u has a value of its own; give it as start",
    ),
}


@pytest.mark.parametrize("body, message", REFUSALS.values(), ids=REFUSALS)
def test_refusal(body, message, tmp_path):
    path = bench.model_file(tmp_path, f"model Model\n{body}\nend Model;\n")
    with pytest.raises(BuildError) as caught:
        translate(path)
    assert str(caught.value) == message.replace("{f}", str(path))


def refused(path: Path, **options: object) -> str:
    with pytest.raises(BuildError) as caught:
        build(path, path.with_suffix(".fmu"), platforms=(), **options)
    assert not path.with_suffix(".fmu").exists()
    return str(caught.value)


def test_a_derivative_of_an_input_is_refused(tmp_path):
    # The compiler itself gives up on it, with a message that names no file.
    path = bench.model_file(
        tmp_path, "model Model\ninput Real u;\nReal x;\nequation\nx = der(u);\nend Model;\n"
    )
    assert refused(path) == (
        f"{path}:1: the Modelica compiler refuses Model\n"
        f"  {path}:5: der(...) must name a coordinate classified as a continuous state"
    )


def test_a_mistake_of_syntax_is_told_with_its_line(tmp_path):
    # Of the folder that it is given, the compiler only says that it cannot be read.
    path = bench.model_file(tmp_path, "model Model\nReal x;\nequation\nder(x) = -x\nend Model;\n")
    assert refused(path) == f"{path}:5:1: unexpected `end`; is a ; missing before it?"
    path = bench.model_file(tmp_path, "model Model\nReal x, y;\nequation\ny = x\nder(x) = y;\nend Model;\n")
    assert refused(path).startswith(f"{path}:5:1: unexpected `der`")
    path = bench.model_file(tmp_path, "model Model\nReal x = (1 + 2;\nend Model;\n")
    assert refused(path).startswith(f"{path}:2:16: unexpected `;`")


@pytest.mark.parametrize(
    ("declared", "told"),
    [
        ('output Real flow(unit="m3/s");', ["2:13: `flow`"]),  # here the compiler asks for a ; before it
        ('Real flow;\nReal type "of it";', ["2:6: `flow`", "3:6: `type`"]),  # and here at the model's name
    ],
)
def test_keywords_as_names_are_told_as_such(tmp_path, declared, told):
    path = bench.model_file(tmp_path, f"model Model\n{declared}\nend Model;\n")
    remedy = "is a keyword of Modelica and can name no variable; take another name"
    assert refused(path).splitlines() == [f"{path}:{one} {remedy}" for one in told]


def test_the_standard_library_is_told_to_be_missing(tmp_path):
    text = "model Model\nModelica.Blocks.Interfaces.RealInput u;\nReal x = u;\nend Model;\n"
    assert "The Modelica Standard Library is not read" in refused(bench.model_file(tmp_path, text))


def test_files_and_names(tmp_path):
    assert refused(tmp_path / "none.mo") == f"{tmp_path}/none.mo: no such file; give the .mo file of a model"
    path = bench.model_file(tmp_path, "package P\nmodel A Real x = time; end A;\nmodel B end B;\nend P;\n")
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
    assert refused(path) == f"{path}:2: cannot read Modelica from '\"open;\\nend M;\\n' on"
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
        f"{path}:4: delay() is lost in flattening; put it into an equation of its own\n"
        f"{path}:5: assert() is lost in flattening; put it into the equation section"
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
        f"{path}:2: x has the attributes inverse, which are not supported"
    )
    assert altered(lambda flat: flat["equations"][0].update(guard=1)) == (
        f"{path}:4: the compiler describes this equation by guard, which is not supported"
    )
    residual = {"Binary": {"op": "Sub", "lhs": {"Quaternion": {}}, "rhs": {"Quaternion": {}}}}
    assert altered(lambda flat: flat["equations"][0].update(residual=residual)) == (
        f"{path}:4: expressions of kind Quaternion are not supported"
    )
    assert altered(lambda flat: flat["equations"][0].update(scalar_count=2)) == (
        f"{path}:4: the compiler counts 2 scalar equations here, 1 were read"
    )
    monkeypatch.setattr(reader, "flatten", flatten.flatten)
    monkeypatch.setattr(flatten, "version", lambda name: "0.9.13")
    assert refused(path) == (
        "Modelica compiler: rumoca 0.9.13 is installed, its representation is known for 0.10.2 only; run "
        "`pip install rumoca==0.10.2`"
    )


def test_a_machine_without_binaries_is_told_what_to_build_for(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("platform.machine", lambda: "riscv64")
    monkeypatch.setattr("platform.system", lambda: "Linux")
    model = tmp_path / "M.mo"
    model.write_text("model M\n  output Real y;\nequation\n  y = time;\nend M;\n")
    command = ["build", str(model), "-o", str(tmp_path / "M.fmu")]
    assert main(command) == 1
    told = capsys.readouterr().err
    assert "binaries cannot be made for this machine, riscv64-linux; name some of x86_64-linux," in told
    assert main([*command, "--platforms", "none"]) == 0


@pytest.mark.parametrize("arguments", [["none.mo"], ["none.py"], ["none.py", "--form", "native"]])
def test_a_missing_model_is_told_before_what_a_build_needs(tmp_path, monkeypatch, capsys, arguments):
    def missing():
        raise BuildError("CasADi is not installed")

    for place in ("native_form", "build"):  # native_form takes its own from build
        monkeypatch.setattr(f"orchestrator.translate.{place}.need_casadi", missing)
    file, *more = arguments
    assert main(["build", str(tmp_path / file), *more]) == 1
    assert f"{tmp_path / file}: no such file; give the .mo or .py file" in capsys.readouterr().err
