"""Solutions, by scipy or by hand, of examples of the Modelica Standard Library.

Their reference results are missing or of another version. The equations are written down here again: nothing
of the translator is used. The names are those that `modelica_models` gives the models.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import cache

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

Signals = dict[str, np.ndarray]
Solution = Callable[[np.ndarray], Signals]


def _eddy_current_brake(part: str, mass: str, position: str, speed: str) -> Solution:
    """A brake of 100 N at 10 m/s, whose excitation rises from 0.1 s to 0.2 s; the loss heats 1 J/K."""

    def force(t: float, v: float, temperature: float) -> float:
        u = v / (10 * (1 + 3.92e-3 * (temperature - 293.15)))
        return 200 * float(np.clip((t - 0.1) / 0.1, 0, 1)) ** 2 * u / (1 + u * u)

    def slope(t: float, z: np.ndarray) -> list[float]:
        f = force(t, z[1], z[2])
        return [z[1], -f, f * z[1]]

    def signals(times: np.ndarray) -> Signals:
        z = solve_ivp(
            slope, (0, times[-1]), [0, 20, 293.15], t_eval=times, rtol=1e-10, atol=1e-10, max_step=0.01
        ).y
        power = [force(t, v, temperature) * v for t, v, temperature in zip(times, z[1], z[2], strict=True)]
        return {
            f"{mass}.{position}": z[0], f"{mass}.{speed}": z[1], "heatCapacitor.T": z[2],
            f"{part}.lossPower": np.array(power),
        }  # fmt: skip

    return signals


@cache
def _heidler() -> tuple[float, float, float]:
    """Amplitude and time constants of a lightning of 10 us to its peak, 350 us to half of it [-, s, s]."""

    def share(t: float, rise: float, fall: float) -> float:
        return (t / rise) ** 5 / (1 + (t / rise) ** 5) * np.exp(-t / fall)

    def off(z: np.ndarray) -> list[float]:
        rise, fall, peak, tenth, eta = z[0] * 1e-6, z[1] * 1e-6, z[2] * 1e-6, z[3] * 1e-6, z[4]
        return [
            fall / peak * 5 - 1 - (peak / rise) ** 5,
            eta - share(peak, rise, fall),
            0.1 * eta - share(tenth, rise, fall),
            0.9 * eta - share(tenth + 8e-6, rise, fall),
            0.5 * eta - share(tenth - 1e-6 + 350e-6, rise, fall),
        ]

    rise, fall, _, _, eta = fsolve(off, [12, 480, 30, 7, 0.9], xtol=1e-13)
    return eta, rise * 1e-6, fall * 1e-6


def _lightning(times: np.ndarray) -> Signals:
    """Waves on two lines of 50 km between a source and a load of 200 ohm, with a current between them."""
    impedance, lag, load = np.sqrt(1e-6 / 15e-12), 50e3 * np.sqrt(1e-6 * 15e-12), 200.0
    eta, rise, fall = _heidler()

    def current(t: float) -> float:
        s = (t - 0.02) / rise
        return 1e4 / eta * s**5 / (1 + s**5) * np.exp(-(t - 0.02) / fall) if s > 0 else 0.0

    def waves(t: float) -> tuple[float, float, float, float, float, float, float]:
        """Voltages of the source, between the lines and of the load; what arrives at the four ends."""
        if t < 0:
            return (0.0,) * 7
        source, middle, end, a, b, c, d = waves(t - lag)
        a, b, c, d = 2 * middle - b, 2 * source - a, 2 * end - d, 2 * middle - c
        voltage = 380e3 * np.sqrt(2 / 3) * np.sin(100 * np.pi * t)
        return voltage, (b + c + current(t) * impedance) / 2, d * load / (load + impedance), a, b, c, d

    found = np.array([waves(float(t)) for t in times]).T
    return {
        "line1.v2": found[1], "line2.v1": found[1], "load.v": found[2],
        "load.LossPower": found[2] ** 2 / load,
        "line1.es": found[3], "line1.er": found[4], "line2.es": found[5], "line2.er": found[6],
    }  # fmt: skip


def _characteristics(times: np.ndarray) -> Signals:
    """Integrals of a pulse of 1 for half of each 20 ms, begun again in each, and what they come to."""
    t = times % 0.02
    on = np.minimum(t, 0.01)
    turn = 100 * np.pi
    of_whole = {
        "mean.y": 0.5, "rectifiedMean.y": 0.5, "rootMeanSquare.y": np.sqrt(0.5),
        "harmonic.y_rms": np.sqrt(2) / np.pi, "harmonic.y_arg": np.pi / 2,
    }  # fmt: skip
    return {
        "mean.x": on, "rectifiedMean.mean.x": on, "rootMeanSquare.mean.x": on,
        "harmonic.mean1.x": np.sqrt(2) * np.sin(turn * on) / turn,
        "harmonic.mean2.x": np.sqrt(2) * (1 - np.cos(turn * on)) / turn,
        **{name: np.full(len(times), value) for name, value in of_whole.items()},
    }  # fmt: skip


def _motor(times: np.ndarray) -> Signals:
    """Winding and core of a motor whose losses change at 360 s of each 600 s [K]."""

    def slope(z: np.ndarray, current_loss: float) -> list[float]:
        loss = current_loss * (1 + 3.03e-3 * (z[0] - 368.15))
        passed = 10 * (z[0] - z[1])
        return [(loss - passed) / 2500, (500 + passed - 25 * (z[1] - 293.15)) / 25000]

    borders = [b for n in range(int(times[-1] // 600) + 1) for b in (600 * n, 600 * n + 360)]
    borders = [b for b in borders if b < times[-1]] + [times[-1]]
    z, found = np.array([293.15, 293.15]), [np.array([[293.15], [293.15]])]
    for begin, end in itertools.pairwise(borders):
        inside = times[(times > begin) & (times <= end)]
        solved = solve_ivp(
            lambda _, z, loss=100 if begin % 600 < 360 else 1000: slope(z, loss),
            (begin, end), z, t_eval=np.unique([*inside, end]), rtol=1e-9, atol=1e-7,
        )  # fmt: skip
        z = solved.y[:, -1]
        found.append(solved.y[:, : len(inside)])
    winding, core = np.concatenate(found, axis=1)[:, : len(times)]
    return {"winding.T": winding, "core.T": core, "Twinding.T": winding - 273.15, "Tcore.T": core - 273.15}


LIBRARY_SOLUTIONS: dict[str, Solution] = {
    "Modelica_Mechanics_Translational_Examples_EddyCurrentBrake": _eddy_current_brake(
        "eddyCurrentForce", "mass", "s", "v"
    ),
    "Modelica_Mechanics_Rotational_Examples_EddyCurrentBrake": _eddy_current_brake(
        "eddyCurrentTorque", "inertia", "phi", "w"
    ),
    "Modelica_Electrical_Analog_Examples_Lines_LightningLosslessTransmissionLine": _lightning,
    "Modelica_Blocks_Examples_DemoSignalCharacteristic": _characteristics,
    "Modelica_Thermal_HeatTransfer_Examples_Motor": _motor,
}
"""Signals of a model at ascending times from 0 [s]."""
