"""The stability of any configured system: modes, and margins of each connection within a feedback loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..base.errors import ConfigError, Problem, listed, nearest
from ..simulation.run import Prepared
from .delay_system import FILTER
from .disk import DiskMargin, disk_margin, sensitivity
from .from_system import Linearised, linearise
from .linearity import Unlike, linearity_text, unlike_parts
from .margins import DelayMargin, Margins
from .modes import Modes
from .moving_point import momentary_roots
from .step_report import step_report, step_text

# A root this near to the imaginary axis, relative to its size or to the largest, counts as on it: measured
# delays are no more exact than that.
_BORDER = 1e-7
_MOST_SHOWN = 3
# Connections that are looked at as later all at once, unless they are named: the time goes with their cube.
_MOST_LATER = 40


def system_stability(
    prepared: Prepared, opened: Sequence[str] = (), linear: Linearised | None = None
) -> dict[str, Any]:
    """Modes and margins of a system around its start, and what the master and its step make of them.

    Args:
        prepared: the checked system.
        opened: connections to open, by their target, as "drive.voltage"; all within loops if none is named.
            Several are also opened at once.
        linear: what `linearise` gave; made here if it is not.
    Returns: a dict, all but `sampled` of it without communication steps:
        `verdict`, `line`, `point`, `notes`.
        `modes`: with `holds_for`, see `momentary_roots`; None of those that last.
        `margins`: weakest connection first. `together`: of the loops that are opened at once, or None.
        `later`: the delay that the opened connections bear at once, or those of all loops if none is opened;
        None of fewer than two or very many.
        `sampled`: see `step_report`. `not_linear`: see `unlike_parts`.
    Raises: ConfigError with all problems; OrchestratorError if the roots cannot be certified.
    """
    linear = linear or linearise(prepared)
    if not linear.system.states:
        what = "no FMU in it has continuous states: there is nothing to be stable or not"
        raise ConfigError([Problem(prepared.config.name, what)])
    modes = linear.system.modes()
    names = _named(linear, opened)
    margins = linear.margins(modes, names)
    disks = {name: disk_margin(linear.system, [name], modes) for name in margins}
    together = None
    if len(names) > 1:
        found = disk_margin(linear.system, names, modes)
        together = {
            "connections": names,
            **_disk(found),
            "sensitivity_peak": _number(found.sensitivity_peak),
            "sensitivity_peak_at": found.sensitivity_peak_at,
        }
    late = names or linear.system.loops()
    later = linear.system.delay_margin(late, modes) if 1 < len(late) <= _MOST_LATER else None
    unlike = unlike_parts(linear.started(prepared), linear, modes) if linear.start is not None else []
    momentary = momentary_roots(prepared, linear, modes)
    return {
        "title": prepared.config.model.title or prepared.config.name,
        "verdict": _verdict(modes, momentary) + _without(unlike, linear.breaks),
        "modes": [
            {
                "root": [one.root.real, one.root.imag],
                "frequency": one.frequency,
                "damping": one.damping,
                "residual": one.residual,
                "participation": dict(one.participation[:_MOST_SHOWN]),
                "holds_for": momentary.get(one.root),
            }
            for one in modes.modes
        ],
        "line": modes.line,
        "margins": {name: {**_margins(one), **_disk(disks[name])} for name, one in margins.items()},
        "together": together,
        "later": None if later is None else _later(later),
        "sampled": step_report(prepared, linear, modes),
        "not_linear": [vars(one) for one in unlike],
        "point": dict(linear.point),
        "notes": list(linear.notes),
    }


def _verdict(modes: Modes, momentary: Mapping[complex, float]) -> str:
    border = [one for one in modes.modes if abs(one.root.real) <= _BORDER * max(abs(one.root), 1e-6)]
    growing = [one.root for one in modes.modes if one not in border and one.root.real > 0.0]
    unstable, slow = (
        sum(2 if root.imag > 0.0 else 1 for root in growing if (root in momentary) == passing)
        for passing in (False, True)
    )
    more = ""
    if slow:
        what = f"{slow} {'more ' if unstable else ''}root{'s' if slow > 1 else ''} with positive real part"
        held = f"{'hold' if slow > 1 else 'holds'} for this moment only"
        more = f"; {what} {held}: the operating point moves faster"
    if unstable:
        return f"unstable: {unstable} root{'s' if unstable > 1 else ''} with positive real part{more}"
    if border:
        names = listed(dict.fromkeys(one.participation[0][0] for one in border if one.participation))
        roots = sum(2 if one.root.imag > 0.0 else 1 for one in border)
        count = f"{roots} root{'s' if roots > 1 else ''}"
        return f"on the border: {count} without damping, of {names}{more}"
    return f"stable{more}"


def _without(unlike: Sequence[Unlike], breaks: Sequence[str]) -> str:
    names = list(dict.fromkeys([*breaks, *(one.instance for one in unlike if not one.drifts)]))
    return f", without what {listed(names)} does beside its linear equations" if names else ""


def _named(linear: Linearised, opened: Sequence[str]) -> list[str]:
    names = [one.connection for one in linear.system.links if FILTER not in one.connection]
    known = {name.rpartition("-> ")[2]: name for name in names}
    problems = [
        Problem("--open", f"nothing is connected to {one}", f"targets: {listed(known)}", nearest(one, known))
        for one in opened
        if one not in known
    ]
    if problems:
        raise ConfigError(problems)
    return [known[one] for one in opened]


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _margins(one: Margins) -> dict[str, Any]:
    low, high = one.gain_margin
    return {
        "gain_margin": [_number(low), _number(high)],
        "phase_margin": _number(one.phase_margin),
        "delay_margin": _number(one.delay_margin),
        "modulus_margin": one.modulus_margin,
        "sensitivity_peak": _number(one.sensitivity_peak),
        "crossovers": [vars(each) for each in one.crossovers],
    }


def _later(one: DelayMargin) -> dict[str, Any]:
    return {
        "connections": list(one.connections),
        "delay_margin": _number(one.delay),
        "omega": _number(one.omega),
    }


def _disk(one: DiskMargin) -> dict[str, Any]:
    stable = bool(np.isfinite(one.margin))
    return {
        "disk_margin": _number(one.margin),
        "disk_gain": [_number(bound) for bound in one.gain] if stable else None,
        "disk_phase": _number(one.phase),
        "disk_margin_at": _number(one.omega),
    }


def system_text(report: dict[str, Any]) -> str:
    """The report as text for terminals."""
    unlike = [Unlike(**one) for one in report["not_linear"]]
    lines = [report["title"], report["verdict"], *linearity_text(unlike), "modes, from the right:"]
    for one in report["modes"]:
        real, imaginary = one["root"]
        root = f"{real:.6g}" + (f" +-{imaginary:.6g}j" if imaginary else "")
        share = ", ".join(f"{name} {100 * part:.0f} %" for name, part in one["participation"].items())
        size = f"{one['frequency']:.4g} Hz, damping {one['damping']:.4g}" if imaginary else "real"
        line = f"  {root} 1/s: {size}; {share}"
        times = sum(other["root"] == one["root"] for other in report["modes"])
        line += f"; {times} times" if times > 1 else ""
        held = one["holds_for"]
        line += f"; for this moment only, changes by 30 % within {_seconds(held)}" if held else ""
        if line != lines[-1]:
            lines.append(line)
    if report["margins"]:
        kind = "crossovers" if report["verdict"].startswith("unstable") else "margins"
        why = " (no margins: the system is unstable)" if kind == "crossovers" else ""
        lines.append(f"{kind} of connections in feedback loops{why}, by modulus, the weakest first:")
    for name, one in report["margins"].items():
        lines.append(f"  {name}: {_in_words(one)}")
    if report["together"] is not None:
        one = report["together"]
        lines.append(f"{len(one['connections'])} loops opened at once: {_disk_in_words(one)}")
    if report["later"] is not None:
        lines += later_words(report["later"])
    lines.append(step_text(report["sampled"], report["verdict"].startswith("stable")))
    lines += [f"note: {one}" for one in report["notes"]]
    return "\n".join(lines)


def later_words(one: dict[str, Any]) -> list[str]:
    """What connections bear that are later all at once; empty if the system is unstable, or bears any."""
    if one["delay_margin"] is None:
        return []
    text = f"{len(one['connections'])} connections later at once: {_seconds(one['delay_margin'])} each"
    return [f"{text}, then {one['omega'] / (2.0 * np.pi):.4g} Hz grows" if one["omega"] else text]


def _seconds(value: float) -> str:
    """A time in ms, or in s from one second on."""
    return f"{value:.6g} s" if value >= 1.0 else f"{1e3 * value:.6g} ms"


def _in_words(one: dict[str, Any]) -> str:
    low, high = one["gain_margin"]
    parts = []
    if (phase := one["phase_margin"]) is not None:
        # Of a stable loop a negative one limits phase that is added.
        lead = phase < 0.0 and one["delay_margin"] is not None
        parts.append(f"phase {abs(phase):.4g} deg of lead" if lead else f"phase {phase:.4g} deg")
    if one["delay_margin"] is not None:
        parts.append(f"delay {_seconds(one['delay_margin'])}")
    bounds = ([f"down to {low:.4g}"] if low else []) + ([f"up to {high:.4g}"] if high else [])
    if bounds:
        parts.append(f"gain times {' or '.join(bounds)}")
    parts.append(f"modulus {one['modulus_margin']:.4g}")
    if one["disk_margin"] is not None:
        parts.append(f"disk {one['disk_margin']:.4g}")
    return ", ".join(parts)


def _disk_in_words(one: dict[str, Any]) -> str:
    if one["disk_margin"] is None:
        return "no disk margin, the system is unstable"
    low, high = one["disk_gain"]
    gains = f"times {low:.4g} to {high:.4g}" if high is not None else f"times {low:.4g} or more"
    return f"disk {one['disk_margin']:.4g}, all gains {gains}, or all phases by {one['disk_phase']:.4g} deg"


def system_figures(report: dict[str, Any], linear: Linearised) -> dict[str, Any]:
    """Figures by name: roots and participation; of the weakest connection Bode, Nyquist, Nichols, step."""
    from . import figures

    made = {
        "roots": figures.root_map(report["modes"], report["sampled"].get("modes", ())),
        "participation": figures.participation(report["modes"]),
    }
    omega = np.geomspace(*_shown(report), 1500)
    if report["margins"]:
        name = next(iter(report["margins"]))
        value = linear.system.open_loop(name, omega)
        made |= {
            "bode": figures.bode(name, omega, value),
            "nyquist": figures.nyquist(name, omega, value),
            "nichols": figures.nichols(name, omega, value),
        }
        time = _step_times(report)
        made["step"] = figures.step_figure(name, time, linear.system.step_response(name, time))
    if report["together"] is not None:
        names = report["together"]["connections"]
        made["sigma"] = figures.sigma(names, omega, sensitivity(linear.system, names, omega))
    return made


def _step_times(report: dict[str, Any]) -> Any:
    """Instants that show how the slowest mode of the loops goes on [s]."""
    roots = [complex(*one["root"]) for one in report["modes"]]
    size = max((abs(one) for one in roots), default=1.0)
    moving = [one for one in roots if abs(one) > 1e-6 * size] or [complex(-1.0)]
    rate = max(abs(moving[0].real), 0.02 * abs(moving[0]))
    # What grows is shown up to a factor of some hundred, what decays to a hundredth.
    length = min(5.0 / rate, 30.0 * 2.0 * np.pi / abs(moving[0]))
    count = int(np.clip(20.0 * length * abs(moving[0]) / (2.0 * np.pi), 1000, 4000))
    return np.linspace(0.0, length, count + 1)


def _shown(report: dict[str, Any]) -> tuple[float, float]:
    """Lowest and highest frequency that figures show [rad/s]."""
    # Roots that a delay adds far to the left would widen it.
    sizes = [abs(complex(*one["root"])) for one in report["modes"]]
    sizes = [one for one in sizes if one > 1e-9][:2] or [1.0]
    crossings = [each["omega"] for one in report["margins"].values() for each in one["crossovers"]]
    return 0.05 * min([*sizes, *crossings]), 20.0 * max([*sizes, *crossings])
