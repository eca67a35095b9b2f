"""Two free-floating satellites that touch: Eqs. (3) to (16) in six degrees of freedom.

Source of the equations: He, Shen, Gao, Zhang, "Active Compliance Control of a Position-Controlled
Industrial Robot for Simulating Space Operations", Sections 2.2 and 2.3. A is the service satellite, which
carries the rod, B the target. README.md beside this file fixes frames and signs and names the misprints;
the equations are in shared/free_bodies.py.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from pythonfmu import Boolean, Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability, Real
from shared.body_checks import appended, finite_problem, inertia_problem, length_problem, mass_problem
from shared.free_bodies import (
    Body,
    Matrix,
    Motion,
    Wrench,
    advance,
    attached,
    composed,
    detached,
    inverted,
    relative,
    rotation,
    times,
    world_times,
)
from shared.space import add, cross, dot, scale, unit

# There a step's error comes to some 2e-8 of the energy; it falls with the fifth power of the turn.
LARGEST_TURN = 0.1


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
            Body(self.mass_a[0], tensors[0], inverted(tensors[0])),
            Body(self.mass_b[0], tensors[1], inverted(tensors[1])),
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
                setattr(self, entry.name, unit(getattr(self, entry.name)))
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
        for name, si, values in (("force", "N", self.force), ("torque", "N.m", self.torque)):
            bad, sentence = finite_problem(f"input {name}", si, values)
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
