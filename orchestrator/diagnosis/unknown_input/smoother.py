"""Kalman filter and smoother of a system with an unknown input at one place.

The state is [states, a law's own states, calibrated parameters, the law's numbers, w, dw/dt]. Parameters and
numbers are constants with a prior. w is a random walk (order 1) or an integrated one (order 2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.compiled_functions import njit
from .evaluation import Inserted, Place, calls_of, past_of
from .model import StateModel
from .open_run import (
    advance,
    jacobians,
    matrix_effort,
    rows_of,
    simulation_effort,
    step_room,
    transition,
)  # fmt: skip

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Smoothed:
    """Result of a filter pass.

    Attributes:
        loglik: of the compared samples. z: end state. covariance: of it.
        path, variance: smoothed state, shape (samples, n), and variance of w; empty without smoothing.
    """

    loglik: float
    z: Array
    covariance: Array
    path: Array
    variance: Array


@njit()
def _filter(
    rows, wiring, z, p, n, ext, held, logged, noise, begin, h, sub, acts, signals, delta, q, nu, ny,
    measured, smooth, smallest,
):  # fmt: skip
    count, nz = len(logged), len(z)
    nw = n[4]
    u, y = np.zeros(nu), np.zeros(ny)
    kept = count if smooth else 1
    zp, pp = np.zeros((kept, nz)), np.zeros((kept, nz, nz))
    zf, pf = np.zeros((kept, nz)), np.zeros((kept, nz, nz))
    fs = np.zeros((kept, nz, nz))
    eye = np.eye(nz)
    past, now, call = past_of(acts, 0)
    room = step_room(z, held)
    loglik = 0.0
    c_w = nz - nw
    for k in range(count):
        if k > 0:
            e0 = ext[k - 1]
            e1 = np.where(held, e0, ext[k])
            a, _, _ = jacobians(
                rows, wiring, z, n, 0.5 * (e0 + e1), (k - 0.5) * h, acts, signals, u, y, delta, measured,
                1e-7,
            )  # fmt: skip
            g = a * (h / sub)
            one = transition(g, eye)
            f = one
            for _ in range(sub - 1):
                f = one @ f
            advance(
                rows, wiring, z, n, e0, ext[k], held, (k - 1) * h, h, acts, signals, u, y, sub,
                past, now, call, room,
            )  # fmt: skip
            p = f @ p @ f.T
            if nw == 1:
                p[c_w, c_w] += q * h
            elif nw == 2:
                p[c_w, c_w] += q * h * h * h / 3.0
                p[c_w, c_w + 1] += q * h * h / 2.0
                p[c_w + 1, c_w] += q * h * h / 2.0
                p[c_w + 1, c_w + 1] += q * h
            for i in range(n[0]):
                p[i, i] += smallest[i]
            if smooth:
                fs[k] = f
        if not (np.all(np.isfinite(z)) and np.all(np.isfinite(p))):
            return -np.inf, z, p, zf, pf[:, 0, 0]
        if smooth:
            zp[k], pp[k] = z, p
        _, c, y0 = jacobians(rows, wiring, z, n, ext[k], k * h, acts, signals, u, y, delta, measured, 1e-7)
        # One compared signal after the other: their noises are independent.
        if k >= begin:
            origin = z.copy()
            for i in range(len(measured)):
                if np.isnan(logged[k, i]):
                    continue
                row = c[i]
                pc = p @ row
                s = row @ pc + noise[i] * noise[i]
                e = logged[k, i] - y0[i] - row @ (z - origin)
                loglik -= 0.5 * (e * e / s + np.log(2.0 * np.pi * s))
                gain = pc / s
                z = z + gain * e
                p = p - np.outer(gain, pc)
            p = 0.5 * (p + p.T)
        if smooth:
            zf[k], pf[k] = z, p
    if not np.isfinite(loglik):
        return -np.inf, z, p, zf, pf[:, 0, 0]
    if not smooth:
        return loglik, z, p, zf, pf[:, 0, 0]
    var = np.zeros(count)
    at = c_w if nw > 0 else 0
    var[count - 1] = pf[count - 1, at, at]
    ps = pf[count - 1]
    for k in range(count - 2, -1, -1):
        d = 1.0 / np.sqrt(np.diag(pp[k + 1]) + 1e-300)
        scaled = pp[k + 1] * np.outer(d, d) + 1e-10 * eye
        right = (fs[k + 1] @ pf[k]) * d.reshape(-1, 1)
        if not (np.all(np.isfinite(scaled)) and np.all(np.isfinite(right))):
            return -np.inf, z, p, zf, var
        gain = np.ascontiguousarray((np.linalg.solve(scaled, right) * d.reshape(-1, 1)).T)
        zf[k] += gain @ (zf[k + 1] - zp[k + 1])
        ps = pf[k] + gain @ (ps - pp[k + 1]) @ gain.T
        var[k] = ps[at, at]
    return loglik, z, p, zf, var


def pass_effort(
    components: int, size: int, sub: int, smooth: bool, laws: Sequence[Inserted] = (), w: Place | None = None
) -> int:
    """Evaluations of components that a filter's pass takes for each sample."""
    linearised = 2 * (1 + size) * calls_of(components, laws, w)
    return simulation_effort(components, sub, laws, w) + linearised + (2 + smooth) * matrix_effort(size, sub)


def filtered(
    model: StateModel,
    ext: Array,
    held: Any,
    logged: Array,
    z: Array,
    variance: Array,
    scale: Array,
    sub: int,
    *,
    laws: Sequence[Inserted] = (),
    w: Place | None = None,
    order: int = 0,
    intensity: float = 0.0,
    begin: int = 0,
    smooth: bool = False,
) -> Smoothed:
    """One pass over a run.

    Args:
        z, variance: start and its variance (or covariance), shape (n,), see the module.
        scale: size of each entry, for differences. order, intensity: of the random walk w.
        begin: samples before it are not compared.
    """
    n, acts, signals = rows_of(model, laws, w, order)
    covariance = np.diag(variance) if variance.ndim == 1 else variance
    model.effort.add(len(ext) * pass_effort(len(model.rows), len(z), sub, smooth, laws, w))
    loglik, end, cov, path, var = _filter(
        model.rows, model.wiring, z.copy(), covariance.copy(), n, ext, held, logged, model.noise, begin,
        model.study.interval, sub, acts, signals, 1e-5 * scale, intensity, len(model.inputs),
        len(model.outputs), model.measured, smooth, 1e-18 * scale * scale,
    )  # fmt: skip
    return Smoothed(float(loglik), end, cov, path, var)
