"""Expandable connectors whose members only connections declare, against exact solutions."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytest.importorskip("rumoca", reason="needs the extra build")

from orchestrator.base.errors import BuildError
from orchestrator.translate.rewriting.buses import with_members
from tests.translate.hybrid.test_hybrid_models import made, run

PARTS = """
  connector RealInput = input Real;
  connector RealOutput = output Real;
  connector BooleanInput = input Boolean;
  connector BooleanOutput = output Boolean;
  connector IntegerInput = input Integer;
  connector IntegerOutput = output Integer;
"""


def test_signals_pass_through_buses_that_declare_none_of_them(tmp_path):
    """A room heated by a switch: the sensor, switch and counter are joined by buses alone."""
    fmu = made(tmp_path, f"""
package P
{PARTS}
  expandable connector Bus "of the whole"
  end Bus;
  expandable connector MeterBus
    Real spare "declared, and connected to nothing";
  end MeterBus;
  expandable connector DisplayBus
  end DisplayBus;
  partial model Part
    Bus bus;
  end Part;
  model Room
    extends Part;
    Real T(start=18, fixed=true);
    RealOutput measured = T;
    BooleanInput heated;
  equation
    der(T) = (if heated then 8 else 0) - T + 15;
    connect(measured, bus.temperature);
    connect(bus.heating, heated);
  end Room;
  model Switch
    extends Part;
    RealInput T;
    BooleanOutput on(start=false, fixed=true);
  equation
    on = T < 19 or pre(on) and T < 21;
    connect(bus.temperature, T);
    connect(on, bus.heating);
  end Switch;
  model Meter "counts how often the heating starts"
    MeterBus meters;
    BooleanInput on;
    IntegerOutput count(start=0, fixed=true);
  equation
    when on then
      count = pre(count) + 1;
    end when;
    connect(on, meters.heating);
    connect(count, meters.starts);
  end Meter;
  model Display
    DisplayBus bus;
    IntegerInput starts;
    output Integer shown = starts;
  equation
    connect(bus.starts, starts);
  end Display;
  model M
    Room room;
    Switch switch;
    Meter meter;
    Display display;
    Bus bus;
    output Real T = room.T;
    output Integer shown = display.shown;
  equation
    connect(room.bus, bus);
    connect(switch.bus, bus);
    connect(bus, meter.meters);
    connect(bus.inner_bus, display.bus);
    connect(bus.inner_bus.starts, meter.count);
  end M;
end P;
""", model="P.M")  # fmt: skip
    found = run(fmu, 4.0, 0.05, "T", "shown")
    # From 18 degrees up to 21, then down to 19 and up again, each a part of an exponential.
    changes, now, value, on = [], 0.0, 18.0, True
    while now < 4:
        end, aim = (23.0, 21.0) if on else (15.0, 19.0)
        changes.append((now, value, end))
        now, value, on = now + math.log((end - value) / (end - aim)), aim, not on
    for place, time in enumerate(found["time"]):
        begin, start, end = [one for one in changes if one[0] <= time][-1]
        assert abs(found["T"][place] - end - (start - end) * math.exp(begin - time)) < 1e-7
        starts = sum(one[2] == 23.0 for one in changes[2:] if one[0] <= time)
        assert found["shown"][place] == starts
    assert found["shown"][-1] >= 2


def test_members_that_nothing_determines_are_refused(tmp_path):
    with pytest.raises(BuildError, match="equations"):
        made(tmp_path, f"""
package P
{PARTS}
  expandable connector Bus
  end Bus;
  model Sink
    RealInput u;
    Bus bus;
  equation
    connect(bus.speed, u);
  end Sink;
  model M
    Sink sink;
    Bus bus;
    Real x(start=1, fixed=true);
  equation
    der(x) = -x;
    connect(sink.bus, bus);
  end M;
end P;
""", model="P.M")  # fmt: skip


def test_connectors_get_the_members_that_they_lack_and_no_others():
    texts = {
        "Bus.mo": 'expandable connector Bus "with \\"one\\" member"\n  Real a;\nend Bus;\n',
        "Own.mo": "expandable connector Own\n  extends Bus;\nend Own;\n",
        "Pin.mo": "connector Pin\n  Real v;\nend Pin;\n",
        "M.mo": """model M
  Own own[2], other(x=1);
  Pin pin;
  Part part;
equation
  connect(part.y, other.a);
  connect(part.y, own[1].b);
  connect(part.z, other.c[2]) annotation(Line(points={{0,0},{1,1}}));
  connect(part.pin, pin);
  connect(part.v, pin.v);
end M;
""",
    }
    assert with_members(texts) == {
        "Bus.mo": 'expandable connector Bus "with \\"one\\" member" Real b; \n  Real a;\nend Bus;\n'
    }
    assert with_members({"Pin.mo": texts["Pin.mo"], "M.mo": texts["M.mo"].replace("Own", "Pin")}) == {}
    assert np.all([text.count("\n") == texts[name].count("\n") for name, text in with_members(texts).items()])
