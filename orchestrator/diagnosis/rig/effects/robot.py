"""Effects of the robot."""

from __future__ import annotations

import math

from ..config_changes import LOAD, ConfigChanges, start, with_unit
from ..effect import Context, Effect, Parameter, Site, law

_FORCE = int(Context.FORCE)
_VELOCITY = int(Context.VELOCITY)


@law
def _backlash(time, step, value, context, memory, theta):
    half = 0.5 * theta[0]
    if memory[1] == 0.0:
        memory[0], memory[1] = value, 1.0
    memory[0] = min(max(memory[0], value - half), value + half)
    return memory[0]


@law
def _friction(time, step, value, context, memory, theta):
    rate = context[_VELOCITY]
    excess = 1.0 + theta[1] * math.exp(-((rate / 2e-3) ** 2))
    return value - theta[0] * math.tanh(rate / 2e-4) * excess


@law
def _load_sensitivity(time, step, value, context, memory, theta):
    return value + theta[0] * context[_FORCE]


EFFECTS = (
    Effect(
        id="robot.backlash",
        words="Play at the output of the drive",
        equation="|x_out - x| <= b/2, x_out moves only when pushed",
        source="Nordin, Gutman: Controlling mechanical systems with backlash, Automatica 38, 2002",
        parameters=(Parameter("width", "m", 0.0002, low=0.0, high=0.005, starts=(2e-05, 0.0001, 0.0003)),),
        site=Site.POSITION,
        apply=_backlash,
        memory=2,
        written=lambda t, rig: start("robot", backlash=(t["width"], "m")),
    ),
    Effect(
        id="robot.bandwidth",
        words="The natural frequency is another than calibrated",
        equation="omega = omega_n (1 + r)",
        source="Eq. 17 of the docking source",
        parameters=(Parameter("relative", "1", 0.3, low=-0.9, high=4.0),),
        changes={"*natural_frequency": "relative"},
    ),
    Effect(
        id="robot.damping",
        words="The damping ratio is another than calibrated",
        equation="xi = xi_n (1 + r)",
        source="Eq. 17 of the docking source",
        parameters=(Parameter("relative", "1", 0.3, low=-0.9, high=4.0),),
        changes={"*damping_ratio": "relative"},
    ),
    Effect(
        id="robot.delay",
        words="The response has more pure delay than calibrated",
        equation="tau = tau_m + d",
        source="Eq. 17 of the docking source",
        parameters=(Parameter("delay", "s", 0.002, low=-0.002, high=0.02),),
        changes={"response_delay": "delay"},
    ),
    Effect(
        id="robot.friction",
        words="Coulomb friction with a Stribeck excess in the servo",
        equation="x'' = u - a tanh(x'/v0) (1 + s exp(-(x'/v_s)^2)), v0 = 0.2 mm/s, v_s = 2 mm/s",
        source="Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30, 1994",
        parameters=(
            Parameter("coulomb", "m/s2", 1.0, low=0.0, high=50.0, starts=(0.5,)),
            Parameter("stribeck", "1", 0.5, low=0.0, high=3.0, starts=(0.3,), shape=True),
        ),
        site=Site.ACCELERATION,
        apply=_friction,
        written=lambda t, rig: start("robot", friction=(t["coulomb"], "m/s2"), stribeck=(t["stribeck"], "1")),
    ),
    Effect(
        id="robot.load-sensitivity",
        words="The contact force disturbs the servo",
        equation="x'' = u + g F",
        source="Siciliano, Sciavicco, Villani, Oriolo: Robotics, sec. 9.2",
        parameters=(Parameter("gain", "m/(s2.N)", 0.05, low=-1.0, high=1.0),),
        site=Site.ACCELERATION,
        apply=_load_sensitivity,
        written=lambda t, rig: ConfigChanges(
            start={"robot": {"load_sensitivity": with_unit(t["gain"], "m/(s2.N)")}}, adds=(LOAD,)
        ),
    ),
)
