"""Effects of the contact."""

from __future__ import annotations

import math

from ..config_changes import start
from ..effect import Context, Effect, Parameter, Site, law

_DEPTH = int(Context.DEPTH)
_DEPTH_RATE = int(Context.DEPTH_RATE)
_SIDE = int(Context.SIDE)
_STIFFNESS = int(Context.STIFFNESS)
_POSITION = int(Context.POSITION)
_VELOCITY = int(Context.VELOCITY)


@law
def _adhesion(time, step, value, context, memory, theta):
    if context[_SIDE] != 0.0:
        memory[0] = context[_SIDE]
        memory[1] = context[_POSITION] - context[_SIDE] * context[_DEPTH]  # surface of the frame
    side = memory[0]
    if side == 0.0 or side * context[_VELOCITY] >= 0.0:
        return value
    return value + side * theta[0] * math.exp(-abs(context[_POSITION] - memory[1]) / theta[1])


@law
def _asymmetry(time, step, value, context, memory, theta):
    return value * (1.0 - theta[0] * context[_SIDE])


@law
def _cubic(time, step, value, context, memory, theta):
    depth = context[_DEPTH]
    return value + context[_STIFFNESS] * theta[0] * depth * (depth / 1e-3) ** 2


@law
def _friction(time, step, value, context, memory, theta):
    return value * (1.0 + theta[0] * math.tanh(context[_DEPTH_RATE] / theta[1]))


@law
def _hertz(time, step, value, context, memory, theta):
    depth = context[_DEPTH]
    if depth <= 0.0:
        return value
    return value + context[_STIFFNESS] * depth * ((depth / theta[1]) ** theta[0] - 1.0)


@law
def _hunt_crossley(time, step, value, context, memory, theta):
    return value + theta[0] * context[_DEPTH] * context[_DEPTH_RATE]


@law
def _plasticity(time, step, value, context, memory, theta):
    depth = context[_DEPTH]
    if depth <= 0.0:
        memory[0] = 0.0
        return value
    memory[0] = max(memory[0], depth)
    if depth >= memory[0]:
        return value
    return value + context[_STIFFNESS] * ((depth - theta[0] * memory[0]) / (1.0 - theta[0]) - depth)


@law
def _second_contact(time, step, value, context, memory, theta):
    return value + theta[0] * context[_STIFFNESS] * max(context[_DEPTH] - theta[1], 0.0)


@law
def _softening(time, step, value, context, memory, theta):
    return value * (1.0 - theta[0] * time)


@law
def _viscoelastic(time, step, value, context, memory, theta):
    if context[_DEPTH] <= 0.0:
        memory[0] = 0.0
        return value
    keep = math.exp(-step / theta[1])
    memory[0] = keep * memory[0] + theta[1] * (1.0 - keep) * context[_DEPTH_RATE]
    return value + theta[0] * context[_STIFFNESS] * memory[0]


# Between these the depth of contacts, and with it the force, hardly says which way to go.
_WALL_OFFSET_STARTS = (1e-5, -1e-5, 1e-4, -1e-4, 3e-4, -3e-4)


EFFECTS = (
    Effect(
        id="contact.adhesion",
        words="A pull-off force",
        equation="A exp(-|g|/r) pulls while the surfaces part, g the gap, negative in contact",
        source="Israelachvili: Intermolecular and Surface Forces, ch. 17 (adhesion hysteresis)",
        parameters=(
            Parameter("force", "N", 2.0, low=0.0, high=100.0, starts=(1.0,)),
            Parameter("range", "m", 0.7, low=2e-6, high=1e-3, starts=(3e-5,), shape=True),
        ),
        site=Site.FORCE,
        apply=_adhesion,
        memory=2,
        written=lambda t, rig: start("contact", adhesion=(t["force"], "N"), adhesion_range=(t["range"], "m")),
    ),
    Effect(
        id="contact.asymmetry",
        words="Front and rear stiffness differ",
        equation="k = k_0 (1 - a) at the front frame, k_0 (1 + a) at the rear",
        source="Eq. 20 of the docking source, per frame",
        parameters=(Parameter("asymmetry", "1", 0.08, low=-0.9, high=0.9),),
        site=Site.STIFFNESS,
        apply=_asymmetry,
        written=lambda t, rig: start("contact", asymmetry=(t["asymmetry"], "1")),
    ),
    Effect(
        id="contact.cubic",
        words="Hardening stiffness",
        equation="F = k d (1 + a (d/d_0)^2), d_0 = 1 mm",
        source="Nayfeh, Mook: Nonlinear Oscillations, Duffing",
        parameters=(Parameter("hardening", "1", 0.2, low=-0.5, high=5.0),),
        site=Site.CONTACT,
        apply=_cubic,
        written=lambda t, rig: start("contact", cubic=(t["hardening"], "1")),
    ),
    Effect(
        id="contact.damping",
        words="The damping is another than calibrated",
        equation="c = c_0 + d",
        source="Eq. 20 of the docking source",
        parameters=(Parameter("damping", "N.s/m", 100.0, low=-500.0, high=5000.0),),
        changes={"contact_damping": "damping"},
    ),
    Effect(
        id="contact.friction",
        words="A force against the direction of penetration",
        equation="F = F_0 (1 + f tanh(d'/v_0))",
        source="Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30, 1994",
        parameters=(
            Parameter("coefficient", "1", 0.05, low=-0.9, high=0.9),
            Parameter("speed", "m/s", 0.7, low=1e-5, high=0.1, starts=(1e-3,), shape=True),
        ),
        site=Site.PUSH,
        apply=_friction,
        written=lambda t, rig: start(
            "contact", friction=(t["coefficient"], "1"), friction_velocity=(t["speed"], "m/s")
        ),
    ),
    Effect(
        id="contact.hertz",
        words="Power-law stiffness",
        equation="F = k d_0 (d/d_0)^(1 + e), the calibrated stiffness holding at d_0",
        source="Johnson: Contact Mechanics, ch. 4",
        parameters=(
            Parameter("exponent", "1", 0.3, low=-0.5, high=2.0, starts=(0.2, -0.2)),
            Parameter("depth", "m", 0.5, low=5e-5, high=1e-2, starts=(5e-4, 1e-3), shape=True),
        ),
        site=Site.CONTACT,
        apply=_hertz,
        written=lambda t, rig: start(
            "contact", hertz_exponent=(t["exponent"], "1"), hertz_depth=(t["depth"], "m")
        ),
    ),
    Effect(
        id="contact.hunt-crossley",
        words="Damping in proportion to the penetration",
        equation="F = k d + h d d'",
        source="Hunt, Crossley, J. Applied Mechanics 42, 1975",
        parameters=(Parameter("damping", "N.s/m2", 150000.0, low=-500000.0, high=5000000.0),),
        site=Site.CONTACT,
        apply=_hunt_crossley,
        written=lambda t, rig: start("contact", hunt_crossley=(t["damping"], "N.s/m2")),
    ),
    Effect(
        id="contact.plasticity",
        words="A permanent set: unloading is steeper than loading",
        equation="unloading from d_m: F = k d_m (d - p d_m)/(d_m (1 - p))",
        source="Johnson: Contact Mechanics, ch. 6",
        parameters=(Parameter("set", "1", 0.05, low=0.0, high=0.9, starts=(0.03,)),),
        site=Site.CONTACT,
        apply=_plasticity,
        memory=1,
        written=lambda t, rig: start("contact", plastic_set=(t["set"], "1")),
    ),
    Effect(
        id="contact.second-contact",
        words="A second stiffness engages at some depth",
        equation="F = k d + r k max(0, d - d_2)",
        source="Piecewise linear contact",
        parameters=(
            Parameter("relative", "1", 0.4, low=-0.9, high=10.0, starts=(0.4,)),
            Parameter("depth", "m", 0.6, low=2e-05, high=0.005, starts=(0.0002, 0.0005, 0.0008), shape=True),
        ),
        site=Site.CONTACT,
        apply=_second_contact,
        written=lambda t, rig: start(
            "contact", second_stiffness=(t["relative"], "1"), second_depth=(t["depth"], "m")
        ),
    ),
    Effect(
        id="contact.softening",
        words="The stiffness falls with time",
        equation="k = k_0 (1 - s t)",
        source="Fatigue or warming of an elastomer",
        parameters=(Parameter("rate", "1/s", 0.06, low=-0.3, high=0.3),),
        site=Site.STIFFNESS,
        apply=_softening,
        written=lambda t, rig: start("contact", softening=(t["rate"], "1/s")),
    ),
    Effect(
        id="contact.stiffness",
        words="The stiffness is another than calibrated",
        equation="k = k_0 (1 + r)",
        source="Eq. 20 of the docking source",
        parameters=(Parameter("relative", "1", 0.2, low=-0.9, high=5.0),),
        changes={"*contact_stiffness": "relative"},
    ),
    Effect(
        id="contact.viscoelastic",
        words="A relaxing force in parallel (Maxwell element)",
        equation="z' = d' - z/T, F = k d + r k z",
        source="Flugge: Viscoelasticity, ch. 1",
        parameters=(
            Parameter("relative", "1", 0.3, low=-0.9, high=5.0, starts=(0.2,)),
            Parameter("time", "s", 0.8, low=0.001, high=2.0, starts=(0.01, 0.03, 0.1), shape=True),
        ),
        site=Site.CONTACT,
        apply=_viscoelastic,
        memory=1,
        written=lambda t, rig: start("contact", maxwell=(t["relative"], "1"), maxwell_time=(t["time"], "s")),
    ),
    Effect(
        id="contact.wall-offset",
        words="The front frame is not where it should be",
        equation="x_front = x_0 + o",
        source="Geometry",
        parameters=(Parameter("offset", "m", 0.0002, low=-0.005, high=0.005, starts=_WALL_OFFSET_STARTS),),
        changes={"front_wall": "offset"},
    ),
)
