"""What the hybrid route refuses: each row of the table in docs/modelica.md, by its message."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

pytest.importorskip("rumoca", reason="needs the extra build")

from orchestrator.base.errors import BuildError
from tests.translate.hybrid.test_adapted_models import TABLES
from tests.translate.hybrid.test_hybrid_models import made

# First column of the table -> model and message, which begins with its place.
PARTS = """package Parts
  model One
    Real y = 1;
  end One;
  model Two
    Real y = 2;
  end Two;
  model General
    replaceable One part;
    Real x(start=0, fixed=true);
  equation
    der(x) = part.y;
  end General;
end Parts;
"""

REFUSED = {
    "members of expandable connectors that only connections declare, and that are arrays or physical": (
        """package M
  connector Pin
    Real v;
    flow Real i;
  end Pin;
  expandable connector Bus
  end Bus;
  model Source
    Pin y;
  equation
    y.v = time;
  end Source;
  model Sink
    Pin u;
  equation
    u.v = u.i;
  end Sink;
  model M
    Source source;
    Sink sink;
    Bus bus;
  equation
    connect(source.y, bus.speed);
    connect(bus.speed, sink.u);
  end M;
end M;
""",
        r"23:\d+: of `source.y` and `bus.speed` one is a member of an expandable .* declare arrays",
    ),
    "a component that `extends` redeclares of a library's class whose own `extends` redeclares it": (
        """package M
  model Special "described"
    extends Parts.General(redeclare replaceable Parts.Two part);
  end Special;
  model M "described"
    extends Special(
      redeclare Parts.One part);
  end M;
end M;
""",
        r"7:\d+: `part` is redeclared here and where Special extends its base, .* extend that base instead",
    ),
    "a component that `extends` redeclares of a class which inherits it from a library": (
        """package M
  model Special
    extends Parts.General;
  end Special;
  model M
    extends Special(redeclare Parts.Two part);
  end M;
end M;
""",
        r"6:\d+: `part` is redeclared here, but Special inherits it, .* extend the class that declares",
    ),
    "`spatialDistribution()`": (
        """model M
  Real x(start=0, fixed=true), a, b;
equation
  der(x) = 1;
  (a, b) = spatialDistribution(sin(time), 0, x, true, {0, 1}, {0, 0});
end M;
""",
        r"5:12: spatialDistribution\(\) is not supported; use delay\(\)",
    ),
    "`delay()` beside events with a delay time that changes": (
        """model M
  Real x(start=1, fixed=true);
  Boolean late(start=false, fixed=true);
equation
  der(x) = -delay(x, 0.1 + x, 2);
  when x < 0.5 then
    late = true;
  end when;
end M;
""",
        r"5:13: delay\(\) with a delay time that changes is not supported .* delay time of parameters",
    ),
    "random numbers: `Modelica.Blocks.Noise`, `Modelica.Math.Random`": (
        """package M
  impure function seed
    input Integer k;
    external "C" seed(k);
  end seed;
  function noise
    input Real x;
    output Real y;
  algorithm
    seed(1);
    y := x;
  end noise;
  model M
    Real y;
  equation
    y = noise(time);
  end M;
end M;
""",
        r"impure functions .* are not supported; read the numbers from a table",
    ),
    "`sample` with a period that is no parameter": (
        """model M
  Real x(start=1, fixed=true);
  Integer n(start=0, fixed=true);
equation
  der(x) = -x;
  when sample(0, x) then
    n = pre(n) + 1;
  end when;
end M;
""",
        r"6:8: the period of sample\(\) changes while the model runs",
    ),
    "algorithm sections: `when` under a condition, loops of unknown length that set members": (
        """model M
  record A
    Real x;
  end A;
  A a;
algorithm
  a.x := time;
  while a.x > 0.1 loop
    a.x := a.x/2;
  end while;
end M;
""",
        r"6: the algorithm of M: a loop of unknown length that assigns a.x is not supported",
    ),
    "clocked equations (`Clock`, `hold`, `previous`)": (
        """model M
  Clock c = Clock(0.1);
  Real x(start=0), u;
equation
  u = sample(time, c);
  x = previous(x) + u;
end M;
""",
        r"6:7: previous\(\) of clocked models is not supported .* use sample\(\) and pre\(\)",
    ),
    "external objects other than tables, impure functions, C functions without source": (
        """model M
  impure function f
    input Real x;
    output Real y;
    external "C" y = f(x);
  end f;
  discrete Real r(start=0, fixed=true);
equation
  when sample(0, 1) then
    r = f(time);
  end when;
end M;
""",
        r"10:9: the impure external function f\(\) is not supported .* write it as a Modelica function",
    ),
    "smooth interpolation of tables of two variables": (
        f"""model M
{TABLES}
  final parameter Table2D id = Table2D(
    [0, 0, 1, 2; 0, 1, 2, 3; 1, 2, 3, 4], Smoothness.Akima, Extrapolation.LastTwoPoints);
  Real y = surface(id, time, 0);
end M;
""",
        r"87:12: smooth interpolation of a CombiTable2D is not supported; choose",
    ),
    "sizes of arrays of components that follow from sums or elements": (
        """package M
  model Part
    Real x(start=0, fixed=true);
  equation
    der(x) = 1;
  end Part;
  model M
    parameter Integer k[2] = {1, 3};
    Part b[k[2]];
  end M;
end M;
""",
        r"9:10: the size of the array `b` is not known .* give it by numbers and Integer parameters",
    ),
    "`reinit` of arrays": (
        """model M
  Real x[2](each start=1, each fixed=true);
equation
  der(x) = -x;
  when x[1] < 0.5 then
    reinit(x, {1, 2});
  end when;
end M;
""",
        r"6:12: reinit of an array is not supported .* reinit its elements one by one",
    ),
}  # fmt: skip


@pytest.mark.parametrize("construct", REFUSED)
def test_a_refusal_names_construct_line_and_remedy(tmp_path, construct):
    text, reported = REFUSED[construct]
    library = tmp_path / "library" / "Parts"
    library.mkdir(parents=True)
    (library / "package.mo").write_text(PARTS)
    with pytest.raises(BuildError) as caught:
        made(tmp_path, text, model="M.M" if text.startswith("package") else None, libraries=[library.parent])
    assert re.search(reported, str(caught.value)), str(caught.value)


def test_the_documentation_lists_these_constructs():
    page = (Path(__file__).parents[3] / "docs" / "modelica.md").read_text()
    table = page[page.index("| refused | by |") :].split("\n\n")[0]
    assert [row.split(" | ")[0].strip("| ") for row in table.splitlines()[2:]] == list(REFUSED)
