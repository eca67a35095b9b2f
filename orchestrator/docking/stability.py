"""What a contact makes of stability: the linear loop in contact, growth of the velocity per contact.

He, Shen, Gao, Zhang, "Active Compliance Control of a Position-Controlled Industrial Robot for Simulating
Space Operations", Eqs. (17), (25) and (27) to (29). All else is `orchestrator.frequency`'s.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..base.arrays import Array, Complex
from ..base.errors import ConfigError, OrchestratorError, Problem, listed
from ..frequency.from_system import Law, Linearised, LinearPoint, linearise
from ..frequency.modes import Mode, Modes
from ..frequency.statespace import StateSpace
from ..results.measures import choose_measures
from ..results.recorders import parameters_of
from ..simulation.run import Prepared, prepare
from .options import DockingOptions

_OFF, _ACTIVE = 1, 3
# How deep the rod stands in its frame [m]: the law of the contact is linear at any depth.
_DEPTH = 5e-3
# Characteristic roots that a contact is made of.
_ROOTS = 6
# A change of the velocity per contact that counts as none: the roots of a loop that is compensated exactly
# lie within rounding of the imaginary axis, on either side.
_BORDER = 1e-5


@dataclass(frozen=True, repr=False)
class ContactLoop:
    """A docking system in contact.

    Attributes:
        linear: the linear system.
        options: names of its instances.
        parameters: "instance.parameter" -> value, SI.
        name: of the system.
    """

    linear: Linearised
    options: DockingOptions
    parameters: Mapping[str, Any]
    name: str

    @staticmethod
    def of(
        config: str | Path | Mapping[str, Any] | Prepared,
        overrides: Iterable[str] = (),
        *,
        stiffness_estimate: float | None = None,
        damping_estimate: float | None = None,
    ) -> ContactLoop:
        """The loop of a config with the measure `docking`.

        Args:
            config, overrides: as `orchestrator.simulation.run.prepare`.
            stiffness_estimate, damping_estimate: what an active controller takes for true [N/m], [N.s/m];
                None:
                the contact's own.
        Raises: ConfigError if the config has no such measure, or as `linearise`.
        """
        prepared = config if isinstance(config, Prepared) else prepare(config, overrides)
        for chosen in choose_measures(prepared.config):
            if isinstance(chosen.options, DockingOptions):
                point = contact_point(prepared, chosen.options, stiffness_estimate, damping_estimate)
                linear = linearise(prepared, point=point)
                return ContactLoop(
                    linear, chosen.options, parameters_of(prepared.system), prepared.config.name
                )
        what = "it has no measure docking, which names satellite, robot and contact"
        raise ConfigError([Problem(prepared.config.name, what)])

    @property
    def back(self) -> str:
        """The connection that brings the force to the satellite."""
        target = f" -> {self.options.satellite}.force"
        names = [one.connection for one in self.linear.system.links if one.connection.endswith(target)]
        if not names:
            raise ConfigError([Problem(self.name, f"nothing is connected to {target[4:]}")])
        return names[0]

    @property
    def share(self) -> float:
        """Of a steady force of the contact, what arrives at the satellite."""
        system, options = self.linear.system, self.options
        still = [
            f"{one}.{name}" for one in (options.satellite, options.robot) for name in ("position", "velocity")
        ]
        given = {name: 0.0 for name in still if name in system.outputs} | {f"{options.contact}.force": 1.0}
        return float(system.driven(given, f"{options.satellite}.force", np.array([1e-9 + 0j]))[0].real)

    @property
    def active(self) -> bool:
        """Whether a controller compensates the force."""
        name = self.options.controller
        return (
            name is not None
            and name in self.linear.of_measures
            and int(self.parameters[f"{name}.mode"]) == _ACTIVE
        )

    @property
    def growth(self) -> float:
        """Of the velocity per contact, by the rightmost roots; NaN if none oscillates."""
        root = contact_root(self.linear.modes())
        return growth_per_contact(root) if root is not None else math.nan


def contact_point(
    prepared: Prepared,
    options: DockingOptions,
    stiffness: float | None = None,
    damping: float | None = None,
) -> LinearPoint:
    """The rod at rest in the front frame, and the law of an active compliance controller.

    Args: stiffness, damping: the controller's estimates; None: the contact's own [N/m], [N.s/m].
    """
    parameters = parameters_of(prepared.system)
    models = {one.name: one.fmu.description.name.rpartition(".")[2] for one in prepared.system.instances}
    place = float(parameters[f"{options.contact}.front"]) + _DEPTH
    start = {options.satellite: {"position": place, "velocity": 0.0}, options.robot: {"position": place}}
    # A controller that acts on a force above a threshold is to see the contact's.
    force = -float(parameters[f"{options.contact}.stiffness"]) * _DEPTH
    start |= {name: {"filtered_force": force} for name, model in models.items() if model == "ForceSensor"}
    laws = {}
    if models[options.satellite] == "SatelliteDynamics":
        mass, eye = float(parameters[f"{options.satellite}.mass"]), np.eye(2)
        names = ("position", "velocity")
        free = StateSpace(np.eye(2, k=1), eye[:, 1:] / mass, eye, np.zeros((2, 1)), names, ("force",), names)
        laws[options.satellite] = Law(free)
    name = options.controller
    if name is not None and models.get(name) == "ComplianceController":
        own = {
            key.partition(".")[2]: value for key, value in parameters.items() if key.startswith(f"{name}.")
        }
        estimates = [
            float(parameters[f"{options.contact}.{kind}"]) if one is None else one
            for kind, one in (("stiffness", stiffness), ("damping", damping))
        ]
        laws[name] = _controller(own, *estimates)
    return LinearPoint(start, laws)


def _controller(p: Mapping[str, Any], stiffness: float, damping: float) -> Law:
    """F_S - k_d (x_des - x) - c_d (v_des - v) in contact, with lead, from sample to sample.

    In the limit of short samples the hold is a delay of half a period, and the lead's difference a
    derivative. Estimates stand still. The restoration of work that was missed at onset is no linear law and
    is left out.
    """
    period, lag, lead, mode = (
        float(p[key]) for key in ("sample_period", "lead_filter_time", "tau_s", "mode")
    )
    inputs = ("measured_force", "position", "velocity", "desired_position", "desired_velocity")
    outputs = ("force", "compensated_force")
    k, c = (stiffness, max(damping, 0.0)) if mode == _ACTIVE else (0.0, 0.0)
    ahead = p["transfer_delay"] + (0.5 * period if p["hold_compensation"] else 0.0)
    motion = np.array([k, c, -k, -(c + k * ahead)])
    led = 0.0 if mode == _OFF else lead
    # Without filter the derivative is one up to frequencies that no loop passes.
    filter_time = max(lag, 1e-7)
    limit = StateSpace(
        np.array([[-1.0 / filter_time]]),
        np.array([[1.0 / filter_time, 0, 0, 0, 0]]),
        np.array([[-led / filter_time], [-lead / filter_time]]),
        np.array([[1.0 + led / filter_time, *motion], [1.0 + lead / filter_time, 0, 0, 0, 0]]),
        ("force_rate",),
        inputs,
        outputs,
    )
    # States: the reading one sample ago, and its filtered difference.
    keep = math.exp(-period / lag) if lag > 0.0 else 0.0
    rate = np.array([-(1.0 - keep) / period, keep])
    fed = (1.0 - keep) / period
    sampled = StateSpace(
        np.array([[0.0, 0.0], rate]),
        np.array([[1.0, 0, 0, 0, 0], [fed, 0, 0, 0, 0]]),
        np.array([led * rate, lead * rate]),
        np.array([[1.0 + led * fed, *motion], [1.0 + lead * fed, 0, 0, 0, 0]]),
        ("previous_force", "force_rate"),
        inputs,
        outputs,
    )
    notes = [
        "its law is that in contact; its sample hold counts as a delay of half a period; estimates stand "
        "still, by default at the true values"
    ]
    if mode == _ACTIVE and p["switching_compensation"]:
        notes.append("switching_compensation is not linear and is left out")
    return Law(limit, 0.5 * period, sampled, period, tuple(notes))


def resting_push(prepared: Prepared, linear: Linearised, options: DockingOptions) -> dict[str, float]:
    """The constant force on the satellite that balances the contact's where the rod rests, by input [N]."""
    loop = ContactLoop(linear, options, parameters_of(prepared.system), prepared.config.name)
    return {
        f"{options.satellite}.force": float(loop.parameters[f"{options.contact}.stiffness"])
        * _DEPTH
        * loop.share
    }


def contact_root(modes: Modes | Iterable[Mode]) -> complex | None:
    """The rightmost root that oscillates, upper half plane [rad/s]; None if none of those listed does."""
    listed_modes = modes.modes if isinstance(modes, Modes) else modes
    return next((one.root for one in listed_modes if one.root.imag > 1e-6 * abs(one.root)), None)


def growth_per_contact(root: complex) -> float:
    """exp(pi sigma/omega): a contact is half an oscillation. Its square is the energy gain."""
    return float(np.exp(np.pi * root.real / root.imag))


@dataclass(frozen=True)
class Contact:
    """One contact after free flight, by the sum over characteristic roots.

    Attributes:
        velocity_ratio: speed after over speed before; its square is the gain of energy.
        duration: from the rod's onset to its release, or with an active controller to the end of its force
            [s].
        peak_force: largest force on the satellite's side of the loop over the approach speed [N.s/m].
        roots: number of roots in the sum.
    """

    velocity_ratio: float
    duration: float
    peak_force: float
    roots: int

    @property
    def energy_gain(self) -> float:
        """Energy after over energy before."""
        return self.velocity_ratio**2


def predict_contact(loop: ContactLoop) -> Contact:
    """The contact that follows a steady approach.

    Until the rod touches, it follows the satellite at the lag T = tau_m + 2 xi_n/omega_n. From then on the
    force is, at unit speed, F(s) = F_0(s)/(1 + L(s)), with F_0 the force of the undisturbed approach: F_0 =
    B/s^2 + E (1/s^2 + T/s), B and E the paths from the rod's and the satellite's position to the force. Its
    poles are the characteristic roots, so the force is a sum of exponentials, each weighed with F_0/L' at
    its root. The contact ends where it would turn into a pull; the impulse until then is

        F(0) + sum of r_i exp(s_i t)/s_i,

    F(0) being the impulse of an endless contact, whatever the number of roots.

    Raises: OrchestratorError if the contact does not end.
    """
    system, options, parameters = loop.linear.system, loop.options, loop.parameters
    back, force = loop.back, f"{options.satellite}.force"
    satellite = [f"{options.satellite}.{name}" for name in ("position", "velocity")]
    robot = [f"{options.robot}.{name}" for name in ("position", "velocity")]

    def driven(given: Mapping[str, Any], s: Complex) -> Complex:
        known = {name: value for name, value in given.items() if name in system.outputs}
        return system.driven(known, force, s.ravel()).reshape(s.shape)

    omega, xi, late = (float(parameters[f"{options.robot}.{name}"]) for name in ("omega_n", "xi_n", "tau_m"))
    lag = late + 2.0 * xi / omega
    still, nothing = dict.fromkeys(robot, 0.0), dict.fromkeys(satellite, 0.0)
    stiffness, damping = (float(parameters[f"{options.contact}.{name}"]) for name in ("stiffness", "damping"))

    def source(s: Complex) -> Complex:
        flat = s.ravel()
        if not loop.active:
            # The frame releases the rod; of the impulse until then the satellite gets the share that the path
            # back lets through, some of it later.
            return -(stiffness + damping * s) / s**2 * share
        rod = driven({robot[0]: 1.0, robot[1]: flat, **nothing}, s)
        desired = driven({satellite[0]: 1.0, satellite[1]: flat, **still}, s)
        # A satellite's velocity is the rate of its deviation, which the constant lag is not part of.
        gap = driven({satellite[0]: 1.0, satellite[1]: 0.0, **still}, s)
        return (rod + desired) / s**2 + gap / s * lag

    share = loop.share

    def arriving(s: Complex) -> Complex:
        return source(s) / (1.0 + system.response(back, s))

    found = [one.root for one in loop.linear.modes(_ROOTS).modes]
    roots = np.array([z for one in found for z in ([one] if one.imag == 0.0 else [one, one.conjugate()])])
    # The controller's filter without a time constant stands far beyond all that moves.
    roots = roots[(abs(roots) > 1e-6) & (abs(roots) < 1e6)]
    mass = float(parameters[f"{options.satellite}.mass"])
    return _contact(arriving, roots, mass, loop.name)


def _contact(force: Callable[[Complex], Complex], roots: Complex, mass: float, name: str) -> Contact:
    from scipy.optimize import brentq  # slow to import

    weights = _residues(force, roots)
    radius = 0.3 * float(np.min(np.abs(roots)))
    impulse = float(np.mean(force(radius * np.exp(2j * np.pi * np.arange(32) / 32))).real)

    def at(time: float) -> float:
        return float(np.sum(weights * np.exp(roots * time)).real)

    slowest = min((abs(root.imag) for root in roots if root.imag != 0.0), default=np.inf)
    if not np.isfinite(slowest):
        raise OrchestratorError(f"{name}: no root oscillates, so the contact does not end")
    times = np.linspace(0.0, 2.0 * np.pi / slowest, 4001)[1:]
    values: Array = np.real(np.exp(np.outer(times, roots)) @ weights)
    # Right after onset the sum has not converged, and the force may not have built up.
    first = len(times) // 20
    begin = first + int(np.argmin(values[first : len(values) // 2]))
    after = np.flatnonzero(values[begin:] >= 0.0)
    if not after.size:
        raise OrchestratorError(f"{name}: the contact does not end within {times[-1]:.3g} s")
    end = brentq(at, times[begin + after[0] - 1], times[begin + after[0]], xtol=1e-14)
    total = impulse + float(np.sum(weights * np.exp(roots * end) / roots).real)
    return Contact(-(1.0 + total / mass), end, -float(values[begin]), len(roots))


def _residues(force: Callable[[Complex], Complex], roots: Complex) -> Complex:
    """Residues by the mean over a small circle around each root: exact for a simple pole, to rounding."""
    apart = np.abs(roots[:, None] - roots[None, :]) + np.diag(np.full(len(roots), np.inf))
    radius = 0.05 * np.minimum(apart.min(axis=1), np.abs(roots))
    turn = np.exp(2j * np.pi * np.arange(24) / 24)
    around = roots[:, None] + radius[:, None] * turn
    return np.mean(force(around) * radius[:, None] * turn, axis=1)


def stability_numbers(
    prepared: Prepared, linear: Linearised, report: Mapping[str, Any], options: DockingOptions
) -> dict[str, Any]:
    """Growth per contact for the report of `orchestrator stability`.

    Returns: a dict with `growth_per_contact` (None if no root oscillates, or roots do not give it), `contact`
        (`velocity_ratio`, `energy_gain`, `duration` [s], `left_out`; or `error`) and `growth_with_steps`.
    """
    if unlike := [one["instance"] for one in report["not_linear"]]:
        why = f"not known by roots, since {listed(unlike)} is not linear in contact"
        return {"growth_per_contact": None, "contact": {"error": why}, "growth_with_steps": None}
    loop = ContactLoop(linear, options, parameters_of(prepared.system), prepared.config.name)
    growth = loop.growth
    contact: dict[str, Any]
    try:
        found = predict_contact(loop)
        contact = {
            "velocity_ratio": found.velocity_ratio,
            "energy_gain": found.energy_gain,
            "duration": found.duration,
            "left_out": [
                f"{name}.switching_compensation"
                for name in filter(None, [options.controller])
                if loop.active and loop.parameters[f"{name}.switching_compensation"]
            ],
        }
    except OrchestratorError as error:
        contact = {"error": str(error)}
    stepped = [complex(*one["root"]) for one in report["sampled"].get("modes", ())]
    half = np.pi / report["sampled"].get("period", np.inf)
    stepped = [root for root in stepped if 0.0 < root.imag < 0.99 * half]
    return {
        "growth_per_contact": growth if np.isfinite(growth) else None,
        "contact": contact,
        "growth_with_steps": growth_per_contact(stepped[0]) if stepped else None,
    }


def stability_lines(numbers: Mapping[str, Any]) -> list[str]:
    """The same in lines for terminals."""
    growth, contact, stepped = (
        numbers[key] for key in ("growth_per_contact", "contact", "growth_with_steps")
    )
    lines = []
    if growth is not None:
        lines.append(f"growth of the velocity per contact: {growth:.5f} by the rightmost roots")
        if abs(growth - 1.0) < _BORDER:
            lines[-1] += "; on the border of stability, a contact changes it by less than 1e-5"
    if "error" in contact:
        lines.append(f"one contact after free flight: {contact['error']}")
    else:
        lines.append(
            f"one contact after free flight: velocity x {contact['velocity_ratio']:.5f}, energy x "
            f"{contact['energy_gain']:.5f}, {contact['duration'] * 1e3:.4g} ms"
        )
        if contact["left_out"]:
            # A run differs most here: no linear loop brings back the work of onset.
            lines[-1] += f", without {listed(contact['left_out'])}, which in a run takes back what onset adds"
    if stepped is not None:
        lines.append(f"growth as co-simulated, with master and step: {stepped:.5f}")
    return lines
