"""Energy gain per contact from the rightmost roots, of an endless contact and of one that ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from ..base.errors import OrchestratorError
from .loop import Loop
from .plant import ACTIVE
from .quasi import Complex, characteristic
from .roots import Roots, rightmost_roots
from .transfer import Array, Transfer

__all__ = ["Contact", "contact_root", "growth_per_contact", "predict_contact", "verdict"]

# A change of the velocity per contact that is told as none: the roots of a loop that is compensated exactly
# lie within rounding of the imaginary axis, on either side.
_BORDER = 1e-5


def contact_root(roots: Roots) -> complex | None:
    """The rightmost root that oscillates, upper half plane [rad/s]; None if none of those listed does."""
    for root in roots.values:
        if root.imag > 0.0:
            return complex(root)
    return None


def growth_per_contact(root: complex) -> float:
    """exp(pi sigma/omega): a contact is half an oscillation. Its square is the energy gain."""
    return float(np.exp(np.pi * root.real / root.imag))


def verdict(unstable: int, growth: float | None) -> str:
    """Whether a loop is stable, in the words of report and figures.

    Args:
        unstable: number of roots with positive real part.
        growth: of the velocity per contact; None where that is not known, or nothing oscillates.
    """
    if growth is not None and abs(growth - 1.0) < _BORDER:
        return "on the border of stability"
    if not unstable:
        return "stable"
    return f"unstable: {unstable} root{'' if unstable == 1 else 's'} with positive real part"


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


def predict_contact(loop: Loop, count: int = 12) -> Contact:
    """The contact that follows a steady approach.

    Until the rod touches, it follows the satellite at the lag T = tau_m + 2 xi_n/omega_n. From then on the
    force is, at unit speed, F(s) = F_0(s)/(1 + L(s)), with F_0 the force of the undisturbed approach:
    F_0 = B/s^2 + E (1/s^2 + T/s), B and E the paths from the rod's and the satellite's position to the
    force. Its
    poles are the characteristic roots, so the force is a sum of exponentials, each weighed with F_0/L' at
    its root.
    The contact ends where it would turn into a pull; the impulse until then is

        F(0) + sum of r_i exp(s_i t)/s_i,

    F(0) being the impulse of an endless contact, whatever the number of roots.

    Args:
        loop: with numbers for parameters, not arrays.
        count: of roots.
    Raises: OrchestratorError if the contact does not end.
    """
    robot, satellite = loop.only("RobotResponse"), loop.only("SatelliteDynamics")
    one, s_times = Transfer.gain(1.0), Transfer.made(np.array([0.0, 1.0]))
    square = Transfer.made(np.ones(1), (np.array([0.0, 0.0, 1.0]),))
    step = Transfer.made(np.ones(1), (np.array([0.0, 1.0]),))
    nothing = {(satellite, "position"): Transfer(), (satellite, "velocity"): Transfer()}
    rod = loop.force_from({(robot, "position"): one, (robot, "velocity"): s_times, **nothing})
    still = {(robot, "position"): Transfer(), (robot, "velocity"): Transfer()}
    desired = loop.force_from({(satellite, "position"): one, (satellite, "velocity"): s_times, **still})
    p = loop.parameters_of(robot)
    lag = p["tau_m"] + 2.0 * p["xi_n"] / p["omega_n"]
    # A satellite's velocity is the rate of its deviation, which the constant lag is not part of.
    gap = loop.force_from({(satellite, "position"): one, (satellite, "velocity"): Transfer(), **still})
    approach = rod * square + desired * square + gap * step * lag
    gain = loop.gain()
    active = any(
        int(loop.parameters[f"{name}.mode"]) == ACTIVE for name in loop.named("ComplianceController")
    )
    if active:
        return _contact(gain, approach, loop, count)
    # The frame releases the rod; of the impulse until then the satellite gets the share that the path back
    # lets through, some of it later.
    name = loop.only("DockingContact")
    contact = loop.parameters_of(name)
    law = Transfer.made(-np.array([contact["stiffness"], contact["damping"]]))
    back = loop.force_from({(name, "force"): one, **nothing})
    share = float(back(0.0).real)
    return _contact(gain, law * square * share, loop, count)


def _contact(gain: Transfer, source: Transfer, loop: Loop, count: int) -> Contact:
    mass = float(loop.parameters[f"{loop.only('SatelliteDynamics')}.mass"])
    roots = rightmost_roots(characteristic(gain, loop.name), count).values

    def force(s: Complex) -> Complex:
        return source(s) / (1.0 + gain(s))

    weights = _residues(force, roots)
    radius = 0.3 * float(np.min(np.abs(roots)))
    impulse = float(np.mean(force(radius * np.exp(2j * np.pi * np.arange(32) / 32))).real)

    def at(time: float) -> float:
        return float(np.sum(weights * np.exp(roots * time)).real)

    slowest = min((abs(root.imag) for root in roots if root.imag != 0.0), default=np.inf)
    if not np.isfinite(slowest):
        raise OrchestratorError(f"{loop.name}: no root oscillates, so the contact does not end")
    times = np.linspace(0.0, 2.0 * np.pi / slowest, 4001)[1:]
    values: Array = np.real(np.exp(np.outer(times, roots)) @ weights)
    # Right after onset the sum has not converged, and the force may not have built up.
    first = len(times) // 20
    begin = first + int(np.argmin(values[first : len(values) // 2]))
    after = np.flatnonzero(values[begin:] >= 0.0)
    if not after.size:
        raise OrchestratorError(f"{loop.name}: the contact does not end within {times[-1]:.3g} s")
    end = brentq(at, times[begin + after[0] - 1], times[begin + after[0]], xtol=1e-14)
    total = impulse + float(np.sum(weights * np.exp(roots * end) / roots).real)
    return Contact(-(1.0 + total / mass), end, -float(values[begin]), len(roots))


def _residues(force: object, roots: Complex) -> Complex:
    """Residues by the mean over a small circle around each root: exact for a simple pole, to rounding."""
    apart = np.abs(roots[:, None] - roots[None, :]) + np.diag(np.full(len(roots), np.inf))
    radius = 0.05 * np.minimum(apart.min(axis=1), np.abs(roots))
    turn = np.exp(2j * np.pi * np.arange(24) / 24)
    around = roots[:, None] + radius[:, None] * turn
    return np.mean(force(around) * radius[:, None] * turn, axis=1)  # type: ignore[operator]
