"""Two free-floating satellites that touch: Eqs. (3) to (16) in six degrees of freedom.

Source of the equations: He, Shen, Gao, Zhang, "Active Compliance Control of a Position-Controlled
Industrial Robot for Simulating Space Operations", Sections 2.2 and 2.3. A is the service satellite, which
carries the rod, B the target. README.md beside this file fixes frames and signs and names the misprints.

Vectors are tuples (x, y, z), matrices tuples of rows, quaternions tuples (w, x, y, z) that turn a body's
coordinates into those of the frame it is given in. Numbers stay plain floats: that traces to native code.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from pythonfmu import Boolean, Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability, Real

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Matrix = tuple[Vector, Vector, Vector]

# Numbers written with seven digits pass, a quaternion that was meant otherwise does not.
LENGTH_TOLERANCE = 1e-6
# Of the trace: what is left when a tensor is turned into another frame in double precision, with room.
INERTIA_TOLERANCE = 1e-9
# There a step's error comes to some 2e-8 of the energy; it falls with the fifth power of the turn.
LARGEST_TURN = 0.1


class Body(NamedTuple):
    """What of a satellite does not change: mass [kg]; inertia and its inverse in the COG frame [kg.m2]."""

    mass: float
    inertia: Matrix
    inverse: Matrix


class Motion(NamedTuple):
    """Pose and twist, all resolved in the frame that they are given in: [m], [1], [m/s], [rad/s]."""

    position: Vector
    orientation: Quaternion
    velocity: Vector
    angular_velocity: Vector


class Wrench(NamedTuple):
    """Force [N] and torque [N.m] on A about `point` [m], all in B's COG frame, in which they are held."""

    force: Vector
    torque: Vector
    point: Vector


def add(a: Vector, b: Vector) -> Vector:
    """a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def subtract(a: Vector, b: Vector) -> Vector:
    """a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def scale(factor: float, a: Vector) -> Vector:
    """factor a."""
    return (factor * a[0], factor * a[1], factor * a[2])


def dot(a: Vector, b: Vector) -> float:
    """a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    """a x b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def times(m: Matrix, a: Vector) -> Vector:
    """Matrix times vector."""
    return (dot(m[0], a), dot(m[1], a), dot(m[2], a))


def transposed_times(m: Matrix, a: Vector) -> Vector:
    """Transposed matrix times vector: with a rotation matrix, the vector in body coordinates."""
    return (
        m[0][0] * a[0] + m[1][0] * a[1] + m[2][0] * a[2],
        m[0][1] * a[0] + m[1][1] * a[1] + m[2][1] * a[2],
        m[0][2] * a[0] + m[1][2] * a[1] + m[2][2] * a[2],
    )


def product(p: Quaternion, q: Quaternion) -> Quaternion:
    """Quaternion product: first q, then p."""
    return (
        p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
        p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
        p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
        p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
    )


def conjugate(q: Quaternion) -> Quaternion:
    """The opposite rotation."""
    return (q[0], -q[1], -q[2], -q[3])


def length(q: Quaternion) -> float:
    """Length of a quaternion [1]."""
    return math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])


def normalised(q: Quaternion) -> Quaternion:
    """The quaternion at unit length."""
    size = length(q)
    return (q[0] / size, q[1] / size, q[2] / size, q[3] / size)


def rotation(q: Quaternion) -> Matrix:
    """Rotation matrix R(q) of a unit quaternion: v in the reference frame = R(q) v in body coordinates."""
    w, x, y, z = q
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


def inverse(m: Matrix) -> Matrix:
    """Inverse of a symmetric matrix, by its cofactors."""
    (a, b, c), (_, d, e), (_, _, f) = m
    aa, bb, cc = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * aa + b * bb + c * cc
    dd, ee, ff = a * f - c * c, b * c - a * e, a * d - b * b
    rows = (aa, bb, cc), (bb, dd, ee), (cc, ee, ff)
    return tuple(tuple(entry / determinant for entry in row) for row in rows)  # type: ignore[return-value]


def world_times(m: Matrix, r: Matrix, a: Vector) -> Vector:
    """R m R' a: a body's tensor, as the source's I_O = R I R', times a vector of the global frame."""
    return times(r, times(m, transposed_times(r, a)))


def rates(y: tuple[float, ...], bodies: tuple[Body, Body], start: tuple[Vector, ...], wrench: Wrench) -> Any:
    """Time derivative of what is integrated over a step.

    Newton's and Euler's equations, (6) to (9), for momenta: what A gains, B loses. The wrench (F, M) about
    the sensor's origin r_S, Eqs. (4) and (5), has the moment M + r_S x F about the step's fixed point.

    Args:
        y: positions of A and B from the fixed point [m], their orientations, and the linear [N.s] and
            angular [N.m.s] impulse on A since the step began, the latter about the fixed point; shape (20,).
        start: linear momentum of A and of B, angular momentum of A and of B about the fixed point, all when
            the step began.
    Returns: shape (20,).
    """
    a, b = bodies
    r_a, r_b, impulse, moment = y[0:3], y[3:6], y[14:17], y[17:20]
    q_a, q_b = y[6:10], y[10:14]
    p_a, p_b = add(start[0], impulse), subtract(start[1], impulse)
    r = rotation(q_b)
    omega_a = world_times(a.inverse, rotation(q_a), subtract(add(start[2], moment), cross(r_a, p_a)))
    omega_b = world_times(b.inverse, r, subtract(subtract(start[3], moment), cross(r_b, p_b)))
    force = times(r, wrench.force)
    torque = add(times(r, wrench.torque), cross(add(r_b, times(r, wrench.point)), force))
    turn_a, turn_b = product((0.0, *omega_a), q_a), product((0.0, *omega_b), q_b)
    return (
        *scale(1.0 / a.mass, p_a),
        *scale(1.0 / b.mass, p_b),
        *(0.5 * entry for entry in turn_a),
        *(0.5 * entry for entry in turn_b),
        *force,
        *torque,
    )


def stage(y: tuple[float, ...], step: float, slope: tuple[float, ...]) -> tuple[float, ...]:
    """y + step slope."""
    return tuple(value + step * rate for value, rate in zip(y, slope, strict=True))


def advance(
    bodies: tuple[Body, Body], motions: tuple[Motion, Motion], wrench: Wrench, step_size: float
) -> tuple[Motion, Motion]:
    """Motion of both satellites over a step with a wrench that is constant in B's turning frame.

    The classical Runge-Kutta method of fourth order on positions, orientations and one impulse: B is given
    the opposite of A's, and angular momenta are kept about one point that stays where it is, so the pair's
    linear and angular momentum do not depend on the method's error; they are conserved to rounding.

    Args:
        bodies: A and B.
        motions: of the COG frames of A and B in the global frame when the step begins.
        wrench: on A; B feels the opposite, along the same line.
        step_size: length of the step [s].
    Returns: motions when the step ends.
    """
    a, b = motions
    fixed = b.position
    r_a = subtract(a.position, fixed)
    p_a, p_b = scale(bodies[0].mass, a.velocity), scale(bodies[1].mass, b.velocity)
    spins = tuple(
        world_times(body.inertia, rotation(motion.orientation), motion.angular_velocity)
        for body, motion in zip(bodies, motions, strict=True)
    )
    start = (p_a, p_b, add(spins[0], cross(r_a, p_a)), spins[1])
    y = (*r_a, 0.0, 0.0, 0.0, *a.orientation, *b.orientation, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    k1 = rates(y, bodies, start, wrench)
    k2 = rates(stage(y, 0.5 * step_size, k1), bodies, start, wrench)
    k3 = rates(stage(y, 0.5 * step_size, k2), bodies, start, wrench)
    k4 = rates(stage(y, step_size, k3), bodies, start, wrench)
    slope = tuple((p + 2.0 * (q + r) + s) / 6.0 for p, q, r, s in zip(k1, k2, k3, k4, strict=True))
    y = stage(y, step_size, slope)
    impulse, moment = y[14:17], y[17:20]
    q_a, q_b = normalised(y[6:10]), normalised(y[10:14])
    spin_a = subtract(add(start[2], moment), cross(y[0:3], add(p_a, impulse)))
    spin_b = subtract(subtract(start[3], moment), cross(y[3:6], subtract(p_b, impulse)))
    return (
        Motion(
            add(fixed, y[0:3]),
            q_a,
            add(a.velocity, scale(1.0 / bodies[0].mass, impulse)),
            world_times(bodies[0].inverse, rotation(q_a), spin_a),
        ),
        Motion(
            add(fixed, y[3:6]),
            q_b,
            subtract(b.velocity, scale(1.0 / bodies[1].mass, impulse)),
            world_times(bodies[1].inverse, rotation(q_b), spin_b),
        ),
    )


def attached(motion: Motion, place: Vector, orientation: Quaternion) -> Motion:
    """Motion of a frame fixed to a body, Eqs. (10) and (11): place and orientation in the COG frame."""
    arm = times(rotation(motion.orientation), place)
    return Motion(
        add(motion.position, arm),
        product(motion.orientation, orientation),
        add(motion.velocity, cross(motion.angular_velocity, arm)),
        motion.angular_velocity,
    )


def relative(of: Motion, to: Motion) -> Motion:
    """Motion of one frame as seen from another, Eqs. (12) and (13).

    Eq. (13) prints T_Ai^-1 T_Bi, which is the opposite; T_Bi^-1 T_Ai is meant, as Eq. (14) needs it. Eq. (12)
    prints v_Ai - v_Bi; the pose of Eq. (13) moves at v_Ai - v_Bi - omega_Bi x (r_Ai - r_Bi).
    """
    r = rotation(to.orientation)
    distance = subtract(of.position, to.position)
    speed = subtract(subtract(of.velocity, to.velocity), cross(to.angular_velocity, distance))
    return Motion(
        transposed_times(r, distance),
        product(conjugate(to.orientation), of.orientation),
        transposed_times(r, speed),
        transposed_times(r, subtract(of.angular_velocity, to.angular_velocity)),
    )


def composed(frame: Motion, within: Motion) -> Motion:
    """The inverse of `relative`: the global motion of what moves as `within` as seen from `frame`."""
    r = rotation(frame.orientation)
    distance = times(r, within.position)
    speed = add(frame.velocity, cross(frame.angular_velocity, distance))
    return Motion(
        add(frame.position, distance),
        product(frame.orientation, within.orientation),
        add(speed, times(r, within.velocity)),
        add(frame.angular_velocity, times(r, within.angular_velocity)),
    )


def detached(motion: Motion, place: Vector, orientation: Quaternion) -> Motion:
    """The inverse of `attached`: motion of the body's COG frame from that of a frame fixed to it."""
    q = product(motion.orientation, conjugate(orientation))
    arm = times(rotation(q), place)
    velocity = subtract(motion.velocity, cross(motion.angular_velocity, arm))
    return Motion(subtract(motion.position, arm), q, velocity, motion.angular_velocity)


def inertia_problem(name: str, m: Matrix) -> tuple[bool, str]:
    """What is wrong with an inertia tensor [kg.m2], whether and as a sentence."""
    (a, b, c), (d, e, f), (g, h, i) = m
    allowed = INERTIA_TOLERANCE * (abs(a) + abs(e) + abs(i))
    if not (max(abs(b - d), abs(c - g), abs(f - h)) <= allowed):
        return True, (
            f"{name} is not symmetric: [1,2], [1,3], [2,3] are {b!r}, {c!r}, {f!r} kg.m2 and [2,1], [3,1], "
            f"[3,2] are {d!r}, {g!r}, {h!r} kg.m2; give both of a pair the same value"
        )
    trace = a + e + i
    if not _positive_definite(a, b, c, e, f, i):
        return True, (
            f"{name} is not positive definite: diagonal {a!r}, {e!r}, {i!r} kg.m2, [1,2], [1,3], [2,3] "
            f"{b!r}, {c!r}, {f!r} kg.m2; its three principal moments have to be above 0 kg.m2"
        )
    # Principal values of trace/2 E - I are half the excess of two principal moments over the third.
    half = (0.5 + INERTIA_TOLERANCE) * trace
    if not _positive_definite(half - a, -b, -c, half - e, -f, half - i):
        return True, (
            f"{name} violates the triangle inequality: diagonal {a!r}, {e!r}, {i!r} kg.m2, [1,2], [1,3], "
            f"[2,3] {b!r}, {c!r}, {f!r} kg.m2; no principal moment of a body is above the sum of the "
            "other two"
        )
    return False, ""


def _positive_definite(a: float, b: float, c: float, d: float, e: float, f: float) -> bool:
    """Whether ((a, b, c), (b, d, e), (c, e, f)) has positive leading minors."""
    minor = a * d - b * b
    determinant = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)
    return (a > 0.0) & (minor > 0.0) & (determinant > 0.0)


def length_problem(name: str, q: Quaternion) -> tuple[bool, str]:
    """What is wrong with a quaternion, whether and as a sentence."""
    size = length(q)
    if abs(size - 1.0) <= LENGTH_TOLERANCE:
        return False, ""
    return True, (
        f"{name} has the length {size!r}; allowed: 1 within {LENGTH_TOLERANCE!r}; divide its elements "
        f"{q[0]!r}, {q[1]!r}, {q[2]!r}, {q[3]!r} by it"
    )


def mass_problem(name: str, mass: float) -> tuple[bool, str]:
    """What is wrong with a mass, whether and as a sentence."""
    if math.isfinite(mass) & (mass > 0.0):
        return False, ""
    return True, f"{name} is {mass!r} kg; a finite mass above 0 kg is needed"


def appended(wrong: bool, bad: bool, sentence: str) -> str:
    """What a list of problems grows by; the native form asks at run time whether it does."""
    if not bad:
        return ""
    if wrong:
        return "; " + sentence
    return sentence


def finite_problem(name: str, unit: str, values: tuple[float, ...]) -> tuple[bool, str]:
    """What of a tuple is no finite number, whether and as a sentence."""
    sound = True
    for value in values:
        sound = sound & math.isfinite(value)
    if sound:
        return False, ""
    given = ", ".join(repr(value) for value in values)
    return True, f"{name} is {given} {unit}; finite numbers are needed"


class Entry(NamedTuple):
    """A variable, or an array of them: name, unit, start values, meaning, causality, dimensions."""

    name: str
    unit: str
    start: tuple[float, ...]
    meaning: str
    kind: str
    shape: tuple[int, ...] = ()
    nominal: str = ""

    def elements(self) -> list[str]:
        """Names of its variables: name, name[1], name[1,1]."""
        if not self.shape:
            return [self.name]
        columns = [f",{column}" for column in range(1, self.shape[1] + 1)] if self.shape[1:] else [""]
        return [f"{self.name}[{row}{column}]" for row in range(1, self.shape[0] + 1) for column in columns]


ZERO, UNIT = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
# A cube of 1 m and 300 kg; a block of 4 m by 2 m by 2 m and 4000 kg, uniform both. Their faces touch.
CUBE = (50.0, 0.0, 0.0, 0.0, 50.0, 0.0, 0.0, 0.0, 50.0)
BLOCK = (8000.0 / 3.0, 0.0, 0.0, 0.0, 20000.0 / 3.0, 0.0, 0.0, 0.0, 20000.0 / 3.0)


def _vector(
    name: str, unit: str, meaning: str, kind: str, start: tuple[float, ...] = ZERO, **more: str
) -> Entry:
    return Entry(name, unit, start, meaning, kind, (len(start),), **more)


ENTRIES = (
    _vector("force", "N", "Force on the rod, in the sensor frame", "input", nominal="100"),
    _vector("torque", "N.m", "Torque on the rod about the sensor frame's origin", "input", nominal="10"),
    Entry("mass_a", "kg", (300.0,), "Mass of the service satellite", "parameter"),
    Entry("mass_b", "kg", (4000.0,), "Mass of the target satellite", "parameter"),
    Entry("inertia_a", "kg.m2", CUBE, "Inertia of the service satellite in O_A", "parameter", (3, 3)),
    Entry("inertia_b", "kg.m2", BLOCK, "Inertia of the target satellite in O_B", "parameter", (3, 3)),
    _vector("assembly_position_a", "m", "Assembly frame O_Ai in O_A", "parameter", (0.5, 0.0, 0.0)),
    _vector("assembly_orientation_a", "1", "Orientation of O_Ai in O_A", "parameter", UNIT),
    _vector("assembly_position_b", "m", "Assembly frame O_Bi in O_B", "parameter", (-2.0, 0.0, 0.0)),
    _vector("assembly_orientation_b", "1", "Orientation of O_Bi in O_B", "parameter", UNIT),
    _vector("sensor_position", "m", "Sensor frame O_ss in O_Bi, as O_sg in O_t", "parameter"),
    _vector("sensor_orientation", "1", "Orientation of O_ss in O_Bi", "parameter", UNIT),
    _vector("start_position", "m", "Position of O_Ai in O_Bi at the start", "parameter"),
    _vector("start_orientation", "1", "Orientation of O_Ai in O_Bi at the start", "parameter", UNIT),
    _vector("start_velocity", "m/s", "Velocity of O_Ai as seen from O_Bi at the start", "parameter"),
    _vector("start_angular_velocity", "rad/s", "Of O_Ai as seen from O_Bi at the start", "parameter"),
    _vector("position", "m", "Position of O_Ai in O_Bi", "computed"),
    _vector("orientation", "1", "Orientation of O_Ai in O_Bi, scalar first", "computed", UNIT),
    _vector("velocity", "m/s", "Velocity of O_Ai's origin as seen from O_Bi", "computed"),
    _vector("angular_velocity", "rad/s", "Angular velocity of O_Ai as seen from O_Bi", "computed"),
    _vector("position_a", "m", "Position of O_A in the global frame", "derived"),
    _vector("orientation_a", "1", "Orientation of O_A in the global frame", "derived", UNIT),
    _vector("velocity_a", "m/s", "Velocity of O_A in the global frame", "derived"),
    _vector("angular_velocity_a", "rad/s", "Angular velocity of A in the global frame", "derived"),
    _vector("position_b", "m", "Position of O_B in the global frame", "state"),
    _vector("orientation_b", "1", "Orientation of O_B in the global frame", "state", UNIT),
    _vector("velocity_b", "m/s", "Velocity of O_B in the global frame", "state"),
    _vector("angular_velocity_b", "rad/s", "Angular velocity of B in the global frame", "state"),
    Entry("kinetic_energy", "J", (0.0,), "Kinetic energy of both satellites", "computed"),
    _vector("linear_momentum", "N.s", "Linear momentum of the pair", "computed"),
    _vector("angular_momentum", "N.m.s", "Angular momentum of the pair about the global origin", "computed"),
)
STATES = tuple(entry.name for entry in ENTRIES if entry.kind in ("state", "derived"))


class SatellitePair(Fmi2Slave):
    """FMI side of the pair: variables, start values, checks."""

    description = "Two free-floating satellites in six degrees of freedom with a contact wrench between them"
    requirements = ()

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.type_attributes: dict[str, dict[str, str]] = {}
        self._known: dict[str, tuple[float, ...]] | None = None
        for entry in ENTRIES:
            # One element holds a number, more a tuple, which stays as it is: FMU state can be put back.
            if entry.kind != "computed":
                setattr(self, entry.name, entry.start)
            for index, name in enumerate(entry.elements()):
                self._register(entry, name, index)
        outputs = {entry.kind: [] for entry in ENTRIES}
        for entry in ENTRIES:
            outputs[entry.kind] += entry.elements()
        self.placed = False
        self.register_variable(
            Boolean(
                "state.placed",
                causality=Fmi2Causality.local,
                variability=Fmi2Variability.discrete,
                initial=Fmi2Initial.exact,
                description="Whether A has been placed, which the end of initialisation does",
                getter=lambda: self.placed,
                setter=self._set_placed,
            )
        )
        # The outputs move only in a step, from the wrench that the step began with: none feeds through.
        self.dependencies = {name: () for kind in ("computed", "derived", "state") for name in outputs[kind]}
        given = (*outputs["parameter"], *outputs["state"])
        self.initial_dependencies = {name: given for name in (*outputs["computed"], *outputs["derived"])}

    def _register(self, entry: Entry, name: str, index: int) -> None:
        causality = {"input": Fmi2Causality.input, "parameter": Fmi2Causality.parameter}
        initial = {"state": Fmi2Initial.exact, "derived": Fmi2Initial.calculated}
        initial["computed"] = Fmi2Initial.calculated
        self.type_attributes[name] = {"unit": entry.unit}
        if entry.nominal:
            self.type_attributes[name]["nominal"] = entry.nominal
        computed = entry.kind == "computed"
        self.register_variable(
            Real(
                name,
                causality=causality.get(entry.kind, Fmi2Causality.output),
                variability=Fmi2Variability.fixed if entry.kind == "parameter" else None,
                initial=initial.get(entry.kind),
                description=entry.meaning,
                getter=(lambda: self._computed()[entry.name][index])
                if computed
                else (lambda: getattr(self, entry.name)[index]),
                setter=None if computed else (lambda value: self._put(entry.name, index, value)),
            )
        )

    def _put(self, name: str, index: int, value: float) -> None:
        values = getattr(self, name)
        setattr(self, name, (*values[:index], value, *values[index + 1 :]))
        if name != "force" and name != "torque":
            self._known = None

    def _set_placed(self, value: bool) -> None:
        self.placed = value
        self._known = None

    def _bodies(self) -> tuple[Body, Body]:
        tensors = _matrix(self.inertia_a), _matrix(self.inertia_b)
        return (
            Body(self.mass_a[0], tensors[0], inverse(tensors[0])),
            Body(self.mass_b[0], tensors[1], inverse(tensors[1])),
        )

    def _motions(self) -> tuple[Motion, Motion]:
        return (
            Motion(self.position_a, self.orientation_a, self.velocity_a, self.angular_velocity_a),
            Motion(self.position_b, self.orientation_b, self.velocity_b, self.angular_velocity_b),
        )

    def _take(self, a: Motion, b: Motion) -> None:
        self.position_a, self.orientation_a, self.velocity_a, self.angular_velocity_a = a
        self.position_b, self.orientation_b, self.velocity_b, self.angular_velocity_b = b
        self._known = None

    def _computed(self) -> dict[str, tuple[float, ...]]:
        """Everything that follows from the two motions, computed once per step."""
        if self._known is None:
            # Until the end of initialisation, A is where its start values would place it.
            a, b = self._motions() if self.placed else (self._start_of_a(), self._motions()[1])
            seen = relative(
                attached(a, self.assembly_position_a, self.assembly_orientation_a),
                attached(b, self.assembly_position_b, self.assembly_orientation_b),
            )
            energy, linear, angular = 0.0, ZERO, ZERO
            for body, motion in zip(self._bodies(), (a, b), strict=True):
                momentum = scale(body.mass, motion.velocity)
                turning = world_times(body.inertia, rotation(motion.orientation), motion.angular_velocity)
                energy = energy + 0.5 * (
                    dot(momentum, motion.velocity) + dot(turning, motion.angular_velocity)
                )
                linear = add(linear, momentum)
                angular = add(angular, add(cross(motion.position, momentum), turning))
            self._known = {
                **seen._asdict(),
                "kinetic_energy": (energy,),
                "linear_momentum": linear,
                "angular_momentum": angular,
            }
        return self._known

    def _wrench(self) -> Wrench:
        """The inputs in B's COG frame; Eq. (2) fixes the sensor frame to B's assembly frame."""
        assembly = rotation(self.assembly_orientation_b)
        sensor = rotation(self.sensor_orientation)
        return Wrench(
            times(assembly, times(sensor, self.force)),
            times(assembly, times(sensor, self.torque)),
            add(self.assembly_position_b, times(assembly, self.sensor_position)),
        )

    def exit_initialization_mode(self) -> None:
        """Check what was set; place A. Raises: ValueError, which the FMI layer turns into a status."""
        wrong, problems = False, ""
        for entry in ENTRIES:
            if entry.kind in ("parameter", "state"):
                bad, sentence = self._problem(entry, getattr(self, entry.name))
                problems = problems + appended(wrong, bad, sentence)
                wrong = wrong | bad
        if wrong:
            raise ValueError(f"{self.instance_name}: {problems}")
        for entry in ENTRIES:
            if entry.kind in ("parameter", "state") and "orientation" in entry.name:
                setattr(self, entry.name, normalised(getattr(self, entry.name)))
        self._take(self._start_of_a(), self._motions()[1])
        self.placed = True

    def _start_of_a(self) -> Motion:
        """A's motion that start_* ask for, seen from B's assembly frame."""
        start = Motion(
            self.start_position, self.start_orientation, self.start_velocity, self.start_angular_velocity
        )
        frame = attached(self._motions()[1], self.assembly_position_b, self.assembly_orientation_b)
        return detached(composed(frame, start), self.assembly_position_a, self.assembly_orientation_a)

    def _problem(self, entry: Entry, values: tuple[float, ...]) -> tuple[bool, str]:
        bad, sentence = finite_problem(entry.name, entry.unit, values)
        if bad:
            return bad, sentence
        if entry.unit == "kg":
            return mass_problem(entry.name, values[0])
        if entry.unit == "kg.m2":
            return inertia_problem(entry.name, _matrix(values))
        if "orientation" in entry.name:
            return length_problem(entry.name, values)
        return False, ""

    def do_step(self, current_time: float, step_size: float) -> bool:
        """One communication step under the wrench that it began with.

        Raises: ValueError, which the FMI layer logs and turns into a status, if an input is not finite or a
            satellite would turn too far for the step. (Returning False would ask the master to end.)
        """
        for name, unit, values in (("force", "N", self.force), ("torque", "N.m", self.torque)):
            bad, sentence = finite_problem(f"input {name}", unit, values)
            if bad:
                raise ValueError(
                    f"{self.instance_name}: in the step from {current_time:.9g} s: {sentence}. Look at what "
                    "is connected to it"
                )
        for name, omega in (("A", self.angular_velocity_a), ("B", self.angular_velocity_b)):
            turn = math.sqrt(dot(omega, omega)) * step_size
            if not turn <= LARGEST_TURN:
                raise ValueError(
                    f"{self.instance_name}: satellite {name} would turn by {turn:.3g} rad in the step from "
                    f"{current_time:.9g} s; allowed: {LARGEST_TURN!r} rad, up to which the integration is "
                    "exact to 1e-7; take a smaller step size"
                )
        self._take(*advance(self._bodies(), self._motions(), self._wrench(), step_size))
        return True


def _matrix(values: tuple[float, ...]) -> Matrix:
    return (values[0:3], values[3:6], values[6:9])  # type: ignore[return-value]
