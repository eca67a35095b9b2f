"""Phase lead and identification of the contact: Eqs. (25) and (26) of the source."""

from __future__ import annotations

import math
from typing import Any, TypeVar

import numpy as np

try:
    from filterpy.kalman import KalmanFilter
except ImportError as error:
    raise ImportError(
        "the controller needs the Python package filterpy where it runs: pip install filterpy"
    ) from error

# Below a thousandth of a newton of innovation the filter would weigh rounding errors.
MINIMUM_FORCE_VARIANCE = 1e-6

# A number, or a Vector.
Quantity = TypeVar("Quantity")


def phase_lead(
    force: Quantity,
    previous_force: Quantity,
    rate: Quantity,
    sample_period: float,
    tau_s: float,
    filter_time: float,
) -> tuple[Quantity, Quantity]:
    """Compensate the sensor delay by a phase lead, Eq. (25).

    Printed as G(s) = 1 + tau_s; implemented as 1 + tau_s*s, which is dimensionless. The derivative is a
    backward difference through a first-order low-pass: a bare difference would multiply noise by tau_s/T.

    Args:
        force: measured force now [N], or a vector of forces or moments; the others alike.
        previous_force: measured force one sample ago [N].
        rate: filtered difference one sample ago [N/s].
        sample_period: T [s].
        tau_s: sensor delay [s].
        filter_time: time constant of the low-pass [s]; 0 for the bare difference.
    Returns: compensated force F_S [N] and filtered difference [N/s].
    """
    keep = math.exp(-sample_period / filter_time) if filter_time > 0.0 else 0.0
    rate = keep * rate + (1.0 - keep) * (force - previous_force) / sample_period
    return force + tau_s * rate, rate


class SageHusaFilter:
    """Sage-Husa adaptive Kalman filter for X = [k_d, c_d], Eq. (26), with A = G = I.

    z = H X + V with z = Delta F_S [N] and H = [-Delta p, -Delta v] ([m], [m/s]): the frame pushes back.
    Noise statistics are estimated with the fading weight d = (1 - b)/(1 - b^n): R from the residual, which
    keeps it positive, Q from the correction, with negative variances cut off and without cross terms. The
    noise means of the full Sage-Husa scheme are taken as zero: in a steady compression they could not be
    told from the signal.
    """

    def __init__(self, state: Any, forgetting_factor: float) -> None:
        self.state = state
        self.forgetting_factor = forgetting_factor
        self._filter = KalmanFilter(dim_x=2, dim_z=1)

    def update(self, force_step: float, position_step: float, velocity_step: float) -> None:
        """Take in one increment of force [N], position [m] and velocity [m/s], Eqs. (22) to (24).

        All that is remembered lies in `state`; filterpy's object is only the calculator.
        """
        s, kalman = self.state, self._filter
        prior = np.array([[s.p_kk, s.p_kc], [s.p_kc, s.p_cc]])
        process = np.array([s.q_kk, s.q_cc])
        kalman.x = np.array([[s.stiffness], [s.damping]])
        kalman.P = prior
        kalman.predict(Q=np.diag(process))
        observation = np.array([[-position_step, -velocity_step]])
        kalman.update(np.array([[force_step]]), R=np.array([[s.r]]), H=observation)
        posterior = 0.5 * (kalman.P + kalman.P.T)
        innovation = float(kalman.y[0, 0])
        residual = force_step - (observation @ kalman.x).item()

        b = self.forgetting_factor
        weight = (1.0 - b) / (1.0 - b ** (s.updates + 2))
        # The diagonal of K y y' K' + P - A P_previous A'.
        correction = kalman.K[:, 0] * innovation
        process = (1.0 - weight) * process + weight * (correction**2 + np.diag(posterior) - np.diag(prior))
        explained = (observation @ posterior @ observation.T).item()
        noise = (1.0 - weight) * s.r + weight * (residual**2 + explained)

        s.stiffness, s.damping = float(kalman.x[0, 0]), float(kalman.x[1, 0])
        s.p_kk, s.p_kc, s.p_cc = float(posterior[0, 0]), float(posterior[0, 1]), float(posterior[1, 1])
        s.q_kk, s.q_cc = max(0.0, float(process[0])), max(0.0, float(process[1]))
        s.r = max(MINIMUM_FORCE_VARIANCE, float(noise))
        s.innovation = innovation
        s.updates += 1
