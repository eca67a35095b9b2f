"""Arrays of FMI variables, and the parameters that all FMUs of the arm have alike."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pythonfmu import Fmi2Causality, Fmi2Initial, Fmi2Variability, Real
from shared.arm import ORIENTATION_TOLERANCE, Frames, Geometry, Joints, tool
from shared.space import Quaternion, length

LENGTHS = {
    "d_1": "Height of A2 above the base",
    "a_1": "Distance of A2 from A1",
    "a_2": "Distance of A3 from A2",
    "a_3": "Offset of A4 from A3, upwards with the forearm level",
    "d_4": "Distance of the wrist's centre from A3 along A4",
    "d_6": "Distance of the flange from the wrist's centre",
}
DEGREE = math.pi / 180.0
# A2 leans back and A3 is bent, so that neither elbow nor wrist is near a singularity with the flange level.
START: Joints = (0.0, 0.0, -100.0 * DEGREE, 130.0 * DEGREE, 0.0, -30.0 * DEGREE, 0.0)
_LEVEL = Frames(
    target_position=(0.0, 0.0, 0.0),
    target_orientation=(1.0, 0.0, 0.0, 0.0),
    tool_position=(0.0, 0.0, 0.3),
    tool_orientation=(math.sqrt(0.5), 0.0, -math.sqrt(0.5), 0.0),
)
FRAMES = {
    "target_position": (
        tool(Geometry(), _LEVEL, START)[0],
        "m",
        "Position of O_t in the base frame; by default O_u's with A2, A3, A5 at -100, 130, -30 degrees",
    ),
    "target_orientation": (_LEVEL.target_orientation, "1", "Orientation of O_t in the base frame"),
    "tool_position": (_LEVEL.tool_position, "m", "Position of O_u in the flange frame"),
    "tool_orientation": (
        _LEVEL.tool_orientation,
        "1",
        "Orientation of O_u in the flange frame; by default x_u is the flange's z",
    ),
}
POSE = {
    "position": ((0.0, 0.0, 0.0), "m", "Position of O_u in O_t"),
    "orientation": ((1.0, 0.0, 0.0, 0.0), "1", "Orientation of O_u in O_t, scalar first"),
    "velocity": ((0.0, 0.0, 0.0), "m/s", "Velocity of the origin of O_u, in O_t"),
    "angular_velocity": ((0.0, 0.0, 0.0), "rad/s", "Angular velocity of O_u, in O_t"),
}


def register(slave: Any, name: str, unit: str, text: str, **more: Any) -> None:
    """Register one number, an attribute of that name; `more` goes to pythonfmu's Real."""
    slave.type_attributes[name] = {"unit": unit}
    slave.register_variable(Real(name, description=text, **more))


def register_array(
    slave: Any, name: str, start: tuple[float, ...], units: str | tuple[str, ...], text: str, **more: Any
) -> None:
    """Register a tuple, an attribute of that name, as variables name[1], name[2], ...

    Args:
        slave: the component.
        name: of the attribute.
        start: its first value.
        units: of every element, or one for all.
        text: description.
        more: goes to pythonfmu's Real.
    """
    setattr(slave, name, start)

    def put(index: int, value: float) -> None:
        old = getattr(slave, name)
        setattr(slave, name, (*old[:index], value, *old[index + 1 :]))

    for index in range(len(start)):
        element = f"{name}[{index + 1}]"
        unit = units if isinstance(units, str) else units[index]
        slave.type_attributes[element] = {"unit": unit}
        slave.register_variable(
            Real(
                element,
                description=text,
                getter=lambda index=index: getattr(slave, name)[index],
                setter=lambda value, index=index: put(index, value),
                **more,
            )
        )


def register_computed(
    slave: Any,
    outputs: dict[str, tuple[tuple[str, ...], str, Any]],
    attributes: tuple[str, ...],
    compute: Callable[[], Any],
) -> Callable[[], Any]:
    """Register arrays of outputs that follow from attributes of the component.

    Args:
        slave: the component.
        outputs: by name the units of the elements, the description, and what to pick out of the result.
        attributes: all that the result follows from; they are replaced, never changed, when they are set.
        compute: gives the result.
    Returns: `compute`, done once as long as the attributes stay.
    """
    memory: dict[str, Any] = {"of": ()}

    def current() -> Any:
        now = tuple(getattr(slave, name) for name in attributes)
        if len(memory["of"]) != len(now) or any(a is not b for a, b in zip(memory["of"], now, strict=True)):
            memory["result"], memory["of"] = compute(), now
        return memory["result"]

    for name, (units, text, pick) in outputs.items():
        for index, unit in enumerate(units):
            element = f"{name}[{index + 1}]"
            slave.type_attributes[element] = {"unit": unit}
            slave.register_variable(
                Real(
                    element,
                    description=text,
                    causality=Fmi2Causality.output,
                    initial=Fmi2Initial.calculated,
                    getter=lambda index=index, pick=pick: pick(current())[index],
                )
            )
    return current


def elements(*names: str, size: int = 7) -> tuple[str, ...]:
    """Names of the elements of arrays."""
    return tuple(f"{name}[{index}]" for name in names for index in range(1, size + 1))


def of_causality(slave: Any, causality: Fmi2Causality) -> tuple[str, ...]:
    """Names of the registered variables of a causality."""
    return tuple(one.name for one in slave.vars.values() if one.causality is causality)


def register_frames(slave: Any) -> None:
    """Register the lengths of the arm and the frames of the experiment as parameters."""
    fixed = {"causality": Fmi2Causality.parameter, "variability": Fmi2Variability.fixed}
    for (name, text), value in zip(LENGTHS.items(), Geometry(), strict=True):
        setattr(slave, name, value)
        register(slave, name, "m", text, **fixed)
    for name, (start, unit, text) in FRAMES.items():
        register_array(slave, name, start, unit, text, **fixed)


PARAMETERS = (*LENGTHS, *FRAMES)


def geometry_of(slave: Any) -> Geometry:
    """The lengths as they are set."""
    return Geometry(slave.d_1, slave.a_1, slave.a_2, slave.a_3, slave.d_4, slave.d_6)


def frames_of(slave: Any) -> Frames:
    """The frames as they are set."""
    return Frames(
        slave.target_position, slave.target_orientation, slave.tool_position, slave.tool_orientation
    )


def problem(right: bool, sentence: str) -> str:
    """A sentence of a refusal unless the condition holds; then ""."""
    if right:
        return ""
    return f" {sentence}."


def refuse(slave: Any, what: str, problems: str) -> None:
    """Raise ValueError with all problems if there are any."""
    if problems:
        raise ValueError(f"{slave.instance_name}: {what}:{problems}")


def not_finite(name: str, value: tuple[float, ...], unit: str) -> str:
    """A sentence for each element of an array that is not a finite number."""
    text = ""
    for index, one in enumerate(value):
        text = text + problem(
            math.isfinite(one), f"{name}[{index + 1}] is {one!r} {unit}; a finite number is needed"
        )
    return text


def no_turn(name: str, value: Quaternion) -> str:
    """A sentence unless a quaternion has length one, but for rounding and drift."""
    size = length(value)
    return problem(
        abs(size - 1.0) <= ORIENTATION_TOLERANCE,
        f"{name} is a quaternion (w, x, y, z) of length {size:.6g}; allowed: 1 within "
        f"{ORIENTATION_TOLERANCE:g}; no turn is (1, 0, 0, 0)",
    )


def wrong_frames(slave: Any) -> str:
    """What is wrong with the parameters that `register_frames` registers."""
    text = ""
    for name in LENGTHS:
        value = getattr(slave, name)
        text = text + problem(math.isfinite(value), f"{name} is {value!r} m; a finite number is needed")
    for name in ("a_2", "d_4"):
        value = getattr(slave, name)
        text = text + problem(value > 0.0, f"{name} is {value!r} m; allowed: above 0 m, it is a link")
    for name, (_, unit, _) in FRAMES.items():
        text = text + not_finite(name, getattr(slave, name), unit)
    for name in ("target_orientation", "tool_orientation"):
        text = text + no_turn(name, getattr(slave, name))
    return text
