"""Faulty models: each message names line and column, shows a caret there, and says what to write."""

from __future__ import annotations

import re

import build_extra  # noqa: F401
import modelica_bench as bench
import pytest

pytest.importorskip("rumoca", reason="needs the extra build")

from orchestrator.base.errors import BuildError
from orchestrator.translate.build import translate
from orchestrator.translate.faults import faults_of

# Body of a model whose `model Model` is line 1; per fault the text under its caret, and words of its message.
# In the body, each construct that is at fault stands between « and ».
FAULTS = {
    "semicolon": (
        "Real x(start=1, fixed=true);\nequation\nder(x) = -x\n«end» Model;",
        ["is a ; missing before it"],
    ),
    "parenthesis": ("Real x = (1 + 2«;»\nend Model;", ["unexpected"]),
    "unknown names": (
        "Real x(start=1, fixed=true), y;\nequation\nder(x) = -«k»*x + «foo»;\ny = 1;\nend Model;",
        ["`k` is declared nowhere", "`foo` is declared nowhere"],
    ),
    "mistyped name": ("Real speed = 1;\nReal x = «sped»;\nend Model;", ["Did you mean speed"]),
    "unknown member": (
        "Sub s;\nReal x = «s.nope»;\nmodel Sub\nReal a = 1;\nend Sub;\nend Model;",
        ["`s.nope` is declared nowhere"],
    ),
    "unknown class": ("«Nowhere» w;\nReal x = 1;\nend Model;", ["no class `Nowhere`; define it, import it"]),
    "unknown function": ("Real x = «undefd»(2);\nend Model;", ["no function `undefd`; define it"]),
    "library": (
        "«Modelica.Blocks.Sources.Sine» s;\nReal x = s.y;\nend Model;",
        ["The Modelica Standard Library is not found: name its folder by --library"],
    ),
    "modifier": ("Sub s(«q»=3);\nmodel Sub\nReal a = 1;\nend Sub;\nend Model;", ["Sub has no `q`"]),
    "final": (
        "Sub s(«a»=2);\nmodel Sub\nfinal parameter Real a = 1;\nend Sub;\nend Model;",
        ["`a` is declared final"],
    ),
    "twice": ("Real x = 1;\nReal «x» = 2;\nend Model;", ["`x` is declared a second time"]),
    "keyword": ("Real «flow» = 1;\nend Model;", ["`flow` is a keyword"]),
    "types": (
        "Real y;\nequation\ny = if time > 0 then «1» else true;\nend Model;",
        ["the types Boolean and Integer do not fit"],
    ),
    "Real to Integer": ("Integer n;\nequation\n«n» = 2.5;\nend Model;", ["convert one, as by integer(x)"]),
    "Real to Boolean": (
        "Boolean b;\nequation\n«b» = time + 1;\nend Model;",
        ["the two sides are of unlike types"],
    ),
    "sizes": ("Real x[3];\nequation\n«x» = {1, 2};\nend Model;", ["arrays of the sizes [3] and [2]"]),
    "subscript": (
        "Real x[3] = {1, 2, 3};\nReal y = «x»[4];\nend Model;",
        ["the subscript 4 of x is outside 1 to 3"],
    ),
    "equality": (
        "Real x = time;\nBoolean b;\nequation\nb = x «==» 1;\nend Model;",
        ["== and <> of Reals are not allowed"],
    ),
    "parameters in a circle": (
        "parameter Real «a» = b;\nparameter Real b = a;\nReal x = a*time;\nend Model;",
        ["the value of `a` depends on itself"],
    ),
    "branches": (
        "Real x, y;\nequation\n«if» time > 1 then\nx = 1;\ny = 2;\nelse\nx = 3;\nend if;\nend Model;",
        ["unlike numbers of equations"],
    ),
    "too few": (
        "Real x(start=1, fixed=true), y, «z»;\nequation\nder(x) = -x;\ny = x;\nend Model;",
        ["too few equations (2 equations for 3 unknowns): none is left that determines z; add one"],
    ),
    "too many": (
        "Real x(start=1, fixed=true);\nequation\nder(x) = -x;\n«x» = 2;\nend Model;",
        ["too many equations (2 equations for 1 unknowns): this one is one too many"],
    ),
    "dependent equations": (
        "Real x, y;\nequation\n«x» + y = 1;\n«2»*x + 2*y = 2;\nend Model;",
        ["the equations do not determine x, y"],
    ),
    "no unknown": (
        "Real x, y, z;\nequation\nx = 1;\n«x» = 2 + time;\nz = sin(time)*y*0 + z;\nend Model;",
        ["an equation holds no unknown"],
    ),
    "over-determined start": (
        "Real «x»(start=1, fixed=true);\ninitial equation\nx = 2;\nequation\nder(x) = -x;\nend Model;",
        ["the start value of x must not have fixed=true"],
    ),
    "two initial equations": (
        "Real x;\ninitial equation\nx = 2;\n«der»(x) = 0;\nequation\nder(x) = -x;\nend Model;",
        ["too many initial equations: this one for der(x) is one too many"],
    ),
    "when twice": (
        "Integer n(start=0, fixed=true);\nequation\nwhen time > 1 then\nn = 1;\nend when;\n"
        "when time > 2 then\n«n» = 2;\nend when;\nend Model;",
        ["`n` is set in several when-clauses; set it in one, with elsewhen"],
    ),
    "reinit": (
        "Real x;\nequation\nx = time;\nwhen time > 1 then\n«reinit»(x, 0);\nend when;\nend Model;",
        ["reinit() of x, which is no state"],
    ),
    "input differentiated": (
        "input Real u;\nReal x, y;\nequation\n«x» = u;\ny = der(x);\nend Model;",
        ["the input u would have to be differentiated; give the derivative as a further input"],
    ),
    "sample period": (
        "Real T = 0.1 + time;\ndiscrete Real y(start=0, fixed=true);\nequation\n"
        "when «sample»(0, T) then\ny = time;\nend when;\nend Model;",
        ["the period of sample() changes"],
    ),
    "external function": (
        'function f\ninput Real u;\noutput Real y;\nexternal "C" y = g(u);\nend f;\n'
        "Real x = «f»(time);\nend Model;",
        ["the external function"],
    ),
    "assignment": ("Real x;\nequation\n«x» := 1;\nend Model;", ["write = in an equation"]),
    "comparison": ("Real x;\nequation\n«x» == 1;\nend Model;", ["`==` compares; write ="]),
    "no else": ("Real x;\nequation\nx = if time > 1 then 2«;»\nend Model;", ["add else"]),
    "no end if": (
        "Real x;\nequation\nif time > 1 then\nx = 1;\nelse\nx = 2;\n«end» Model;",
        ["the `if` of line 4 is not closed; put `end if;`"],
    ),
    "elsewhen alone": (
        "Real x(start=1, fixed=true);\nequation\nder(x) = -x;\n«elsewhen» x < 1 then\n"
        "reinit(x, 2);\nend when;\n"
        "end Model;",
        ["`elsewhen` stands in no if or when"],
    ),
    "open text": ('Real x «"»of it = 1;\nend Model;', ["is not closed by another one"]),
    "letters": ("Real gr«ö»sse = 1;\nend Model;", ["names hold letters from a to z"]),
    "number of inputs": (
        "function f\ninput Real u;\noutput Real y;\nalgorithm\ny := u;\nend f;\n"
        "Real x = «f»(1, 2);\nend Model;",
        ["the function f() takes 1 inputs, here are 2"],
    ),
    "name of an input": (
        "function f\ninput Real u;\noutput Real y;\nalgorithm\ny := u;\nend f;\nReal x = f(«w»=1);\n"
        "end Model;",
        ["the function f() has no input `w`"],
    ),
    "number of arguments": ("Real x = «sin»(1, 2);\nend Model;", ["sin() takes 1 arguments, here are 2"]),
    "Boolean in a sum": (
        "Boolean b = time > 1;\nReal x = «b» + 1;\nend Model;",
        ["`+` takes numbers, this is a Boolean"],
    ),
    "condition": (
        "Real x(start=1, fixed=true);\nequation\nder(x) = 1;\nwhen «x» then\nreinit(x, 0);\n"
        "end when;\nend Model;",
        ["the condition of a when is a Boolean, this is a Real"],
    ),
    "no connectors": (
        "Real a = 1;\nReal b;\nequation\nconnect(«a», «b»);\nend Model;",
        ["connect() takes connectors, `a` is none"],
    ),
    "no base class": ("«extends» Basis;\nReal x = 1;\nend Model;", ["no class `Basis` to extend"]),
    "pre of a state": (
        "Real x(start=1, fixed=true);\nequation\nder(x) = -«pre»(x);\nend Model;",
        ["has a meaning in when-clauses only"],
    ),
    "reinit outside": (
        "Real x(start=1, fixed=true);\nequation\nder(x) = -x;\n«reinit»(x, 1);\nend Model;",
        ["reinit() stands in no when-clause"],
    ),
    "when in when": (
        "Integer n(start=0);\nequation\n«when» time > 1 then\nwhen time > 2 then\nn = 1;\n"
        "end when;\nend when;\n"
        "end Model;",
        ["a when within a when"],
    ),
    "size": (
        "Real «x»[3];\nequation\nfor i in 1:4 loop\nx[i] = i;\nend for;\nend Model;",
        ["x is declared with the size [3], its equations use [4]"],
    ),
    "size beside events": (
        "Real «x»[3];\nInteger n(start=0);\nequation\nfor i in 1:4 loop\nx[i] = i;\nend for;\n"
        "when time > 1 then\nn = 1;\nend when;\nend Model;",
        ["x is declared with the size [3], its equations use [4]"],
    ),
    "function without a rule": (
        "Real a[1, 1] = [time];\nReal x = «scalar»(a);\nend Model;",
        ["scalar() is not supported; name the element by its subscripts"],
    ),
    "Integers for Reals": (
        "Real c[3];\nequation\n«c» = cross({1, 2, 3}, {time, 0, 1});\nend Model;",
        ["write them as 1.0"],
    ),
    "result left out": (
        "function f\ninput Real u;\noutput Real a;\noutput Real b;\nalgorithm\na := u;\nb := u;\nend f;\n"
        "Real x;\nequation\n«(», x) = f(time);\nend Model;",
        ["a result that is left out before others"],
    ),
    "member of a result": (
        "record R\nReal a;\nend R;\nfunction f\ninput Real u;\noutput R r;\nalgorithm\nr.a := u;\nend f;\n"
        "Real x = f(time)«.»a;\nend Model;",
        ["give the result a name, as R r = f(x)"],
    ),
    "members of a grid": (
        "model Sub\nReal x = time;\nend Sub;\nSub a[2, 2];\nReal s = sum(«a.x»);\nend Model;",
        ["name the elements, as {{a[i, j].x"],
    ),
    "members of arrays within arrays": (
        "model Sub\nReal x = time;\nend Sub;\nmodel Both\nSub b[2];\nend Both;\nBoth a[2];\n"
        "Real s «=» sum(a.b[2].x);\nend Model;",
        ["name the elements, as {{a[i].b[j].x"],
    ),
    "endless recursion": (
        "function f\ninput Real n;\noutput Real y;\nalgorithm\ny := if n < 1 then 1 else n*«f»(n - 1);\n"
        "end f;\nReal x = f(time);\nend Model;",
        ["calls itself without end"],
    ),
}


@pytest.mark.parametrize(("body", "reported"), FAULTS.values(), ids=FAULTS)
def test_each_fault_has_its_place_and_remedy(body, reported, tmp_path):
    marked = f"model Model\n{body}\n"
    text = marked.replace("«", "").replace("»", "")
    path = bench.model_file(tmp_path, text)
    with pytest.raises(BuildError) as caught:
        translate(path)
    shown = str(caught.value).splitlines()
    faults = faults_of(str(caught.value))
    places = [place for fault in faults for place in fault.places]
    wanted = []
    for found in re.finditer("«(.*?)»", marked):
        before = marked[: found.start()].replace("«", "").replace("»", "")
        wanted.append((str(path), before.count("\n") + 1, len(before) - before.rfind("\n")))
    assert places == wanted
    for words in reported:
        assert any(words in fault.what for fault in faults)
    # The line of each place, and below it a caret under the construct.
    pictures = [n for n, one in enumerate(shown) if re.match(r" +\d+ \| ", one)]
    for (_, line, column), found, at in zip(wanted, re.finditer("«(.*?)»", marked), pictures, strict=True):
        source = text.splitlines()[line - 1]
        assert shown[at] == f"{line:>6} | {source}"
        assert shown[at + 1].partition("| ")[2].index("^") == column - 1
        assert source[column - 1 :].startswith(found[1])


def test_a_renamed_variable_does_not_move_the_caret(tmp_path):
    """The compiler takes v for V and sees other names; the places are those of the source."""
    path = bench.model_file(tmp_path, "model Model\nReal v = 1, V = 2;\nReal y = v + V + lost;\nend Model;\n")
    with pytest.raises(BuildError) as caught:
        translate(path)
    assert str(caught.value).splitlines()[0].startswith(f"{path}:3:18: `lost`")
    path = bench.model_file(
        tmp_path, "model Model\nReal V[2], v = 2;\nequation\nV = v*{1, 2, 3} ;\nend Model;\n"
    )
    with pytest.raises(BuildError) as caught:
        translate(path)
    assert str(caught.value).splitlines()[0].startswith(f"{path}:4:1: arrays of the sizes [2] and [3]")


def test_places_hold_where_the_compiler_sees_a_rewritten_line(tmp_path):
    """der() of an expression is rewritten before the compiler; what comes after it keeps line and column."""
    text = "model Model\nReal x(start=1, fixed=true), y; Real z;\nReal w;\nequation\nder(x) = -x; "
    text += "y = der(x*x); z = x + missing;\nend Model;\n"
    path = bench.model_file(tmp_path, text)
    for name in ("w", "z"):
        with pytest.raises(BuildError) as caught:
            translate(bench.model_file(tmp_path, text.replace("missing", "0") if name == "w" else text))
        place = faults_of(str(caught.value))[0].places[0]
        line = 3 if name == "w" else 5
        source = text.splitlines()[line - 1]
        assert place == (str(path), line, source.index("missing" if name == "z" else "w") + 1)
