"""Simulate open runs, and how small changes of numbers or small inputs change them.

The vector z holds [states, laws' own states, calibrated parameters, laws' numbers, w, dw/dt]; w is an unknown
input, which filters estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.compiled_functions import njit
from .evaluation import Inserted, Place, acts_of, calls_of, evaluate, past_of
from .model import StateModel

Array = NDArray[np.float64]
# States beyond it have run away; FMUs would complain of each infinite number that follows.
_AWAY = 1e100
# Most times that the argument of an exponential is halved.
_HALVED = 40


@njit(allocates=False)
def _rates_at(rows, wiring, z, n, ext, t, acts, signals, u, y, rate, extra, past, now, call):
    nx, nh, np_, nt, nw = n
    a, b, c = nx + nh, nx + nh + np_, nx + nh + np_ + nt
    w = z[c] if nw > 0 else 0.0
    evaluate(
        rows, wiring, z[:nx], ext, z[a:b], t, acts, w, signals, z[b:c], z[nx:a], u, y, rate, extra,
        past, now, call,
    )  # fmt: skip


@njit()
def step_room(z, held):
    """Room for one step: four slopes and the begin of z; fed signals within a sample."""
    return np.zeros((5, len(z))), np.zeros(len(held))


@njit(allocates=False)
def advance(rows, wiring, z, n, e0, e1, held, t, h, acts, signals, u, y, sub, past, now, call, room):
    """RK4 over one sample; moves z, which is not a number after states have run away."""
    nx, nh, np_, nt, nw = n
    m, d = nx + nh, h / sub
    c = m + np_ + nt
    k, ext = room
    base = k[4]
    first = now[0]
    for s in range(sub):
        for j in range(len(z)):  # base[:] = z would allocate
            base[j] = z[j]
        now[0] = first + s
        for i in range(4):
            now[1] = (0.0, 0.5, 0.5, 1.0)[i]
            now[3] = (1.0, 3.0, 3.0, 2.0)[i]
            f = (s + now[1]) / sub
            for j in range(len(ext)):
                ext[j] = e0[j] if held[j] else e0[j] + (e1[j] - e0[j]) * f
            if i > 0:
                g = d * (0.0, 0.5, 0.5, 1.0)[i]
                for j in range(m):
                    z[j] = base[j] + g * k[i - 1, j]
                if nw == 2:
                    z[c] = base[c] + g * base[c + 1]
            _rates_at(
                rows, wiring, z, n, ext, t + f * h, acts, signals, u, y, k[i, :nx], k[i, nx:m],
                past, now, call,
            )  # fmt: skip
        size = 0.0
        for j in range(m):
            z[j] = base[j] + d / 6.0 * (k[0, j] + 2.0 * k[1, j] + 2.0 * k[2, j] + k[3, j])
            size += abs(z[j])
        if nw == 2:
            z[c] = base[c] + d * base[c + 1]
        if not size < _AWAY:
            for j in range(m):
                z[j] = np.nan
            break
    now[0], now[1], now[3] = first + sub, 0.0, 0.0


@njit()
def jacobians(rows, wiring, z, n, ext, t, acts, signals, u, y, delta, measured, tiny):
    """Derivatives of the rates and of the compared signals by z, and the compared signals."""
    nx, nh, nw = n[0], n[1], n[4]
    m, nz = nx + nh, len(z)
    a, c = np.zeros((nz, nz)), np.zeros((len(measured), nz))
    r0, r1 = np.zeros(m), np.zeros(m)
    rate, extra = r1[:nx], r1[nx:]
    past, now, call = past_of(acts, 0)
    _rates_at(rows, wiring, z, n, ext, t, acts, signals, u, y, r0[:nx], r0[nx:], past, now, call)
    y0 = y[measured].copy()
    for i in range(nz - (1 if nw == 2 else 0)):
        old = z[i]
        step = delta[i] + tiny * abs(old)
        z[i] = old + step
        _rates_at(rows, wiring, z, n, ext, t, acts, signals, u, y, rate, extra, past, now, call)
        z[i] = old
        for j in range(m):
            a[j, i] = (r1[j] - r0[j]) / step
        for j in range(len(measured)):
            c[j, i] = (y[measured[j]] - y0[j]) / step
    if nw == 2:
        a[nz - 2, nz - 1] = 1.0
    return a, c, y0


@dataclass(frozen=True)
class Tangent:
    """An open run, and how small inputs at some places change it.

    m is the number of states, those of inserted laws among them. An input changes linearly within a sample.

    Attributes:
        signals: [states, inputs, outputs] at each sample. ends: the same just before it, where held signals
            still have their last values. Shape (samples, signals).
        onward: change of the states at a sample by those at the sample before, shape (samples, m, m).
        first, last: the same by what an input adds to the derivatives at the begin and at the end of the
            interval between them.
        rates, direct: derivatives of the states' rates and of the compared signals by an input, shapes
            (samples, places, m) and (samples, places, compared). seen: of compared signals by states.
    """

    signals: Array
    ends: Array
    onward: Array
    first: Array
    last: Array
    rates: Array
    direct: Array
    seen: Array


@njit()
def transition(g, eye):
    """exp(g) to the fourth order, as a step of RK4 has it, of a part of g that is small enough.

    At the corner of a law such as dry friction, a mode may be faster than a step. Its series would grow.
    """
    fastest = 0.0
    for i in range(len(g)):
        for j in range(i + 1):
            fastest = max(fastest, abs(g[i, j] * g[j, i]))
    halved = 0
    while fastest > 1.0 and halved < _HALVED:
        fastest /= 4.0
        halved += 1
    part = g / 2.0**halved
    one = eye + part @ (eye + part @ (eye / 2.0 + part @ (eye / 6.0 + part / 24.0)))
    for _ in range(halved):
        one = one @ one
    return one


@njit()
def _simulate(rows, wiring, z, n, ext, held, h, sub, acts, signals, nu, ny, measured):
    u, y = np.zeros(nu), np.zeros(ny)
    count = len(ext)
    nx = n[0]
    found, signal = np.full((count, len(measured)), np.nan), np.full((count, nx + nu + ny), np.nan)
    rate, extra = np.zeros(nx), np.zeros(n[1])
    past, now, call = past_of(acts, count * sub)
    now[2] = h / sub
    z, room = z.copy(), step_room(z, held)
    for k in range(count):
        if k > 0:
            advance(
                rows, wiring, z, n, ext[k - 1], ext[k], held, (k - 1) * h, h, acts, signals, u, y, sub,
                past, now, call, room,
            )  # fmt: skip
        if not np.all(np.isfinite(z)):
            break
        _rates_at(rows, wiring, z, n, ext[k], k * h, acts, signals, u, y, rate, extra, past, now, call)
        found[k] = y[measured]
        signal[k, :nx] = z[:nx]
        signal[k, nx : nx + nu] = u
        signal[k, nx + nu :] = y
    return found, signal


@njit()
def _sensitive(rows, wiring, z, n, ext, held, h, sub, acts, signals, delta, nu, ny, measured):
    """Derivatives of the compared outputs by z at the start, shape (samples, compared, len(z)).

    The transition over a sample is that of the mean of the Jacobians at both ends.
    """
    u, y = np.zeros(nu), np.zeros(ny)
    count, nz = len(ext), len(z)
    found = np.zeros((count, len(measured), nz))
    along, eye = np.eye(nz), np.eye(nz)
    past, now, call = past_of(acts, 0)
    z, room = z.copy(), step_room(z, held)
    before = np.zeros((nz, nz))
    for k in range(count):
        if k > 0:
            advance(
                rows, wiring, z, n, ext[k - 1], ext[k], held, (k - 1) * h, h, acts, signals, u, y, sub,
                past, now, call, room,
            )  # fmt: skip
        if not np.all(np.isfinite(z)):
            break
        a, c, _ = jacobians(rows, wiring, z, n, ext[k], k * h, acts, signals, u, y, delta, measured, 1e-7)
        if k > 0:
            g = (a + before) * (0.5 * h / sub)
            one = transition(g, eye)
            for _ in range(sub):
                along = one @ along
        if not np.all(np.isfinite(along)):
            break
        before = a
        found[k] = c @ along
    return found


@njit()
def _between(a, sub, h, onward, first, last):
    """Transition over a sample, and the effect of what changes linearly within it; see `Tangent`."""
    m, d = len(a), h / sub
    # The exponential of this matrix holds the integrals of that of its first block, too.
    g = np.zeros((3 * m, 3 * m))
    g[:m, :m] = a * d
    for j in range(m):
        g[j, m + j] = d
        g[m + j, 2 * m + j] = 1.0
    blocks = transition(g, np.eye(3 * m))
    one, rising = blocks[:m, :m].copy(), blocks[:m, 2 * m :].copy()
    falling = blocks[:m, m : 2 * m] - rising
    onward[:] = np.eye(m)
    for j in range(sub):
        begin, end = j / sub, (j + 1) / sub
        onward[:] = one @ onward
        first[:] = one @ first + falling * (1.0 - begin) + rising * (1.0 - end)
        last[:] = one @ last + falling * begin + rising * end


@njit()
def _tangent(
    rows, wiring, z, n, ext, held, h, sub, acts, signals, delta, w_acts, w_delta, nu, ny, measured
):  # fmt: skip
    u, y = np.zeros(nu), np.zeros(ny)
    count, nx, m, places = len(ext), n[0], n[0] + n[1], len(w_acts)
    signal, ends = np.full((count, nx + nu + ny), np.nan), np.zeros((count, nx + nu + ny))
    onward, first, last = np.zeros((count, m, m)), np.zeros((count, m, m)), np.zeros((count, m, m))
    rates, direct = np.zeros((count, places, m)), np.zeros((count, places, len(measured)))
    seen = np.zeros((count, len(measured), m))
    past, now, call = past_of(acts, count * sub)
    now[2] = h / sub
    w_past, w_now, w_call = past_of(acts, 0)
    w_past = np.zeros((len(acts) + 1, 0, 3))
    z, room = z.copy(), step_room(z, held)
    r0, r1, before = np.zeros(m), np.zeros(m), np.zeros((m, m))
    c = len(z) - 1
    for k in range(count):
        if k > 0:
            advance(
                rows, wiring, z, n, ext[k - 1], ext[k], held, (k - 1) * h, h, acts, signals, u, y, sub,
                past, now, call, room,
            )  # fmt: skip
        if not np.all(np.isfinite(z)):
            break
        if k > 0 and np.any(held):
            e1 = np.where(held, ext[k - 1], ext[k])
            _rates_at(rows, wiring, z, n, e1, k * h, acts, signals, u, y, r1[:nx], r1[nx:], past, now, call)
            ends[k, :nx], ends[k, nx : nx + nu], ends[k, nx + nu :] = z[:nx], u, y
        _rates_at(rows, wiring, z, n, ext[k], k * h, acts, signals, u, y, r0[:nx], r0[nx:], past, now, call)
        signal[k, :nx], signal[k, nx : nx + nu], signal[k, nx + nu :] = z[:nx], u, y
        if k == 0 or not np.any(held):
            ends[k] = signal[k]
        a, by, y0 = jacobians(
            rows, wiring, z[:c], n[:5] * np.array([1, 1, 1, 1, 0]), ext[k], k * h, acts, signals, u, y,
            delta, measured, 1e-7,
        )  # fmt: skip
        seen[k] = by[:, :m]
        _rates_at(
            rows, wiring, z, n, ext[k], k * h, w_acts[0], signals, u, y, r0[:nx], r0[nx:],
            w_past, w_now, w_call,
        )  # fmt: skip
        for place in range(places):
            z[c] = w_delta[place]
            _rates_at(
                rows, wiring, z, n, ext[k], k * h, w_acts[place], signals, u, y, r1[:nx], r1[nx:],
                w_past, w_now, w_call,
            )  # fmt: skip
            rates[k, place] = (r1 - r0) / w_delta[place]
            direct[k, place] = (y[measured] - y0) / w_delta[place]
        z[c] = 0.0
        if k > 0:
            _between(0.5 * (a[:m, :m] + before), sub, h, onward[k], first[k], last[k])
        before = a[:m, :m].copy()
    return signal, ends, onward, first, last, rates, direct, seen


@njit()
def _signals(rows, wiring, path, n, ext, h, acts, signals, nu, ny):
    u, y = np.zeros(nu), np.zeros(ny)
    count, nx = len(path), n[0]
    rate, extra = np.zeros(nx), np.zeros(n[1])
    found = np.zeros((count, nx + nu + ny))
    past, now, call = past_of(acts, 0)
    for k in range(count):
        _rates_at(
            rows, wiring, path[k].copy(), n, ext[k], k * h, acts, signals, u, y, rate, extra, past, now, call
        )
        found[k, :nx] = path[k, :nx]
        found[k, nx : nx + nu] = u
        found[k, nx + nu :] = y
    return found


def rows_of(model: StateModel, laws: Sequence[Inserted], w: Place | None, order: int) -> tuple[Any, Any, Any]:
    """Sizes of the parts of z, and what acts with the signals that it reads; see `acts_of`."""
    hidden, numbers = sum(one.states for one in laws), sum(one.numbers for one in laws)
    n = np.array([len(model.states), hidden, len(model.parameters), numbers, order], np.int64)
    return n, *acts_of(laws, w, model.study.interval)


def simulation_effort(
    components: int, sub: int, laws: Sequence[Inserted] = (), w: Place | None = None
) -> int:
    """Evaluations of components that a simulation takes for each sample.

    The last three of the four slopes of a step take the capacities that an exchange had at the first one.
    """
    return sub * (3 * components + calls_of(components, laws, w))


def matrix_effort(count: int, sub: int) -> int:
    """Evaluations of components that take as long as the products of matrices over a sample."""
    return (5 + sub) * count**3 // 1000


def substeps(model: StateModel, scale: Array, fed: Array) -> int:
    """Steps of RK4 a sample that keep the fastest mode within 0.7 of a step.

    Args:
        fed: a run's first fed values. Its signals count as they are and as 0, where the system may answer to
            one of both only: a rope needs a length.
    """
    count, signals_fed = len(model.states), len(model.study.fed)
    if not count:
        return 1
    n, acts, signals = rows_of(model, (), None, 0)
    z = np.concatenate([model.start, model.nominal])
    u, y = np.zeros(len(model.inputs)), np.zeros(len(model.outputs))
    delta = np.concatenate([1e-6 * scale, 1e-6 * np.abs(model.nominal) + 1e-12])
    fastest = 0.0
    for ext in (fed, np.r_[np.zeros(signals_fed), fed[signals_fed:]]):
        a, _, _ = jacobians(
            model.rows, model.wiring, z, n, ext, 0.0, acts, signals, u, y, delta, model.measured, 0.0
        )
        if np.isfinite(a).all():
            fastest = max(fastest, float(np.abs(np.linalg.eigvals(a[:count, :count])).max()))
    return int(min(50, max(1, np.ceil(fastest * model.study.interval / 0.7))))


def simulated(
    model: StateModel, ext: Array, held: Any, z: Array, sub: int, laws: Sequence[Inserted] = ()
) -> tuple[Array, Array]:
    """Compared outputs and all signals [states, inputs, outputs] of an open run from z."""
    n, acts, signals = rows_of(model, laws, None, 0)
    model.effort.add(len(ext) * simulation_effort(len(model.rows), sub, laws))
    return _simulate(
        model.rows, model.wiring, z, n, ext, held, model.study.interval, sub, acts, signals,
        len(model.inputs), len(model.outputs), model.measured,
    )  # fmt: skip


def sensitive(
    model: StateModel, ext: Array, held: Any, z: Array, scale: Array, sub: int,
    laws: Sequence[Inserted] = (),
) -> Array:  # fmt: skip
    """Derivatives of the compared outputs of an open run by each entry of z at its start.

    Args:
        scale: size of each entry, for differences.
    Returns: shape (samples, compared, len(z)); zeros after a run that is not finite.
    """
    n, acts, signals = rows_of(model, laws, None, 0)
    linearised = (1 + len(z)) * calls_of(len(model.rows), laws) + matrix_effort(len(z), sub)
    model.effort.add(len(ext) * (simulation_effort(len(model.rows), sub, laws) + linearised))
    return _sensitive(
        model.rows, model.wiring, z, n, ext, held, model.study.interval, sub, acts, signals, 1e-5 * scale,
        len(model.inputs), len(model.outputs), model.measured,
    )  # fmt: skip


def tangent(
    model: StateModel, ext: Array, held: Any, z: Array, scale: Array, sub: int, laws: Sequence[Inserted],
    places: Sequence[tuple[Place, float]],
) -> Tangent:  # fmt: skip
    """How small inputs at some places change an open run.

    Args:
        scale: size of each entry of z, for differences. places: with sizes of inputs there.
    """
    n, acts, signals = rows_of(model, laws, None, 1)
    w_acts = np.array([rows_of(model, laws, place, 1)[1] for place, _ in places])
    deltas = np.array([1e-5 * size for _, size in places])
    linearised = len(z) * calls_of(len(model.rows), laws)
    linearised += sum(calls_of(len(model.rows), laws, place) for place, _ in places)
    model.effort.add(len(ext) * (simulation_effort(len(model.rows), sub, laws) + linearised))
    made = _tangent(
        model.rows, model.wiring, np.append(z, 0.0), n, ext, held, model.study.interval, sub, acts, signals,
        1e-5 * scale, w_acts, deltas, len(model.inputs), len(model.outputs), model.measured,
    )  # fmt: skip
    return Tangent(*made)


def signals_along(
    model: StateModel, ext: Array, path: Array, laws: Sequence[Inserted], w: Place | None, order: int
) -> Array:
    """All signals along a smoothed path."""
    n, acts, signals = rows_of(model, laws, w, order)
    return _signals(
        model.rows, model.wiring, path, n, ext, model.study.interval, acts, signals,
        len(model.inputs), len(model.outputs),
    )  # fmt: skip
