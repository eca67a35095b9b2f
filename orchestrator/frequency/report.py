"""What `orchestrator stability` tells: margins, critical delays, roots, growth per contact, figures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..base.errors import ConfigError, OrchestratorError, listed
from ..simulation.run import Prepared, prepare
from .charts import chart
from .gain import contact_root, growth_per_contact, predict_contact, verdict
from .loop import Loop
from .margins import critical_delays, margins
from .plant import ACTIVE
from .roots import rightmost_roots
from .sampled import sample
from .transfer import Transfer

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["stability", "stability_figures"]


def stability(
    config: str | Path | Mapping[str, Any] | Prepared, overrides: Iterable[str] = ()
) -> dict[str, Any]:
    """Analyse a configured docking system.

    Args: as `orchestrator.simulation.run.prepare`.
    Returns: a dict with `verdict`, `margins`, `critical_delays` (of the robot's tau_m), `roots`,
        `growth_per_contact`, `contact`, `step` and `notes`.
    Raises: ConfigError with all problems.
    """
    prepared = config if isinstance(config, Prepared) else prepare(config, overrides)
    loop = Loop.of(prepared)
    margin = margins(loop.gain())
    roots = rightmost_roots(loop.characteristic())
    first = contact_root(roots)
    growth = None if first is None else growth_per_contact(first)
    contact: dict[str, Any] | None
    try:
        predicted = predict_contact(loop)
        contact = {
            "velocity_ratio": predicted.velocity_ratio,
            "energy_gain": predicted.energy_gain,
            "duration": predicted.duration,
            "left_out": [f"{name}.switching_compensation" for name in loop.switching()],
        }
    except OrchestratorError as error:
        contact = {"error": str(error)}
    return {
        "title": prepared.config.model.title,
        "verdict": verdict(margin.unstable, growth),
        "margins": {
            "stable": margin.stable,
            "unstable_roots": margin.unstable,
            "crossovers": [vars(one) for one in margin.crossovers],
            "phase_margin": margin.phase_margin,
            "delay_margin": _number(margin.delay_margin),
            "gain_margin": [_number(one) for one in margin.gain_margin],
            "modulus_margin": margin.modulus_margin,
            "sensitivity_peak": margin.sensitivity_peak,
            "complementary_peak": margin.complementary_peak,
        },
        "critical_delays": _critical(loop),
        "roots": [[root.real, root.imag] for root in roots.values],
        "residual": float(np.max(roots.residuals)),
        "growth_per_contact": growth,
        "contact": contact,
        "step": _step(prepared, loop),
        "notes": list(loop.notes),
    }


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _critical(loop: Loop) -> dict[str, Any]:
    """Critical values of the robot's delay, which only those terms of the loop hold that pass the robot."""
    name = f"{loop.only('RobotResponse')}.tau_m"
    without = loop.with_parameters({name: 0.0}).gain()
    # A delay that no sum of the others can equal says which terms hold it.
    mark = 1.0 + 10.0 * without.longest_delay
    marked = loop.with_parameters({name: mark}).gain()
    fixed = Transfer(tuple(term for term in marked.terms if float(term.delay) < mark))
    delayed = Transfer(
        tuple(
            type(term)(term.numerator, term.factors, term.delay - mark)
            for term in marked.terms
            if float(term.delay) >= mark
        )
    )
    up_to = max(0.02, 2.0 * float(loop.parameters[name]))
    begin, found = critical_delays(fixed, delayed, up_to)
    return {
        "parameter": name,
        "up_to": up_to,
        "unstable_without": begin,
        "delays": [vars(one) for one in found],
    }


def _step(prepared: Prepared, loop: Loop) -> dict[str, Any] | None:
    """What the communication step makes of the growth; None where the master is not analysed."""
    run = prepared.config.model.run
    master = run.master if isinstance(run.master, str) else run.master.get("name")
    options = {} if isinstance(run.master, str) else run.master
    held = not options.get("extrapolation") and not options.get("interpolation")
    if (
        master not in ("jacobi", "gauss-seidel", "iterative")
        or not held
        or any(one.ratio != 1 for one in prepared.system.instances)
    ):
        return None
    size = float(prepared.grid.step_size)
    sampling = {"master": master, "step_size": size}
    try:
        return {**sampling, "growth_per_contact": _number(sample(loop, master, size).growth())}
    except ConfigError as error:
        return {**sampling, "growth_per_contact": None, "error": str(error)}


def _factors(fall: float | None, rise: float | None) -> str:
    """Factors by which the gain of a loop may fall and rise, in words."""
    down = f"down to {fall:.4g} times" if fall else "down to nothing"
    up = "up without limit" if rise is None else f"up to {rise:.4g} times ({20.0 * np.log10(rise):.3g} dB)"
    return f"the gain may go {down} and {up}"


def text(report: Mapping[str, Any]) -> str:
    """The report as it is printed."""
    m, lines = report["margins"], [report["title"] or ""]
    growth = report["growth_per_contact"]
    border = report["verdict"] == verdict(0, 1.0)
    lines.append(report["verdict"] + (": a contact changes the velocity by less than 1e-5" if border else ""))
    for one in m["crossovers"]:
        lines.append(
            f"crossover at {one['omega'] / (2 * np.pi):.4g} Hz: phase margin {one['phase_margin']:.4g} deg"
            + (f", delay margin {one['delay_margin'] * 1e3:.4g} ms" if m["stable"] else "")
        )
    if m["stable"]:
        lines.append(f"gain margin: {_factors(*m['gain_margin'])}")
    lines.append(f"modulus margin {m['modulus_margin']:.4g}, sensitivity peak {m['sensitivity_peak']:.4g}")
    critical = report["critical_delays"]
    for one in critical["delays"]:
        way = "unstable" if one["to_right"] else "a pair of roots comes back"
        lines.append(
            f"{critical['parameter']} beyond {one['delay'] * 1e3:.5g} ms: {way}, "
            f"{one['omega'] / (2 * np.pi):.4g} Hz"
        )
    if not critical["delays"]:
        state = "stable" if critical["unstable_without"] == 0 else "unstable"
        state = "on the border" if border else state
        lines.append(f"{critical['parameter']} up to {critical['up_to'] * 1e3:g} ms: {state} throughout")
    for real, imag in report["roots"]:
        if imag >= 0.0:
            lines.append(f"root {real:.6g} {'+-' + format(imag, '.6g') + 'j ' if imag else ''}[1/s]")
    if growth is not None:
        lines.append(f"growth of the velocity per contact: {growth:.5f} by the rightmost roots")
    contact = report["contact"]
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
            if growth is not None:
                lines[-1] += f" to the {growth:.5f} above"
    step = report["step"]
    if step is None:
        lines.append("what the communication step adds is not analysed for this master with these options")
    elif step["growth_per_contact"] is None:
        lines.append(f"what the communication step adds is not known: {step.get('error', 'no oscillation')}")
    else:
        lines.append(
            f"with {step['master']} at {step['step_size'] * 1e3:g} ms: "
            f"growth {step['growth_per_contact']:.5f}"
        )
    return "\n".join([*(line for line in lines if line), *(f"note: {note}" for note in report["notes"])])


def stability_figures(loop: Loop) -> dict[str, Figure]:
    """Bode, Nyquist, Nichols, roots and a chart: over the robot's delay and the contact's damping.

    With an active controller the chart is over the delay and the stiffness that the controller takes for
    true.
    """
    from . import figures

    gain = {loop.name: loop.gain()}
    roots = rightmost_roots(loop.characteristic())
    first = contact_root(roots)
    robot, contact = loop.only("RobotResponse"), loop.only("DockingContact")
    delay, damping = f"{robot}.tau_m", f"{contact}.damping"
    here = float(loop.parameters[delay]), float(loop.parameters[damping])
    late = here[0] + 2.0 * loop.parameters[f"{robot}.xi_n"] / loop.parameters[f"{robot}.omega_n"]
    widest = max(2.5 * late * float(loop.parameters[f"{contact}.stiffness"]), 1.5 * here[1])
    # With several delays each point costs a count of its own.
    points = 200 if len(loop.characteristic().delays) <= 2 else 60
    across = np.linspace(0.0, max(0.01, 2.0 * here[0]), points)
    active = [
        name for name in loop.named("ComplianceController") if int(loop.parameters[f"{name}.mode"]) == ACTIVE
    ]
    if active:
        stiffness = float(loop.parameters[f"{contact}.stiffness"])
        upward = f"{active[0]}.stiffness_estimate", np.linspace(0.5, 1.5, points) * stiffness
        here = here[0], float(loop.parameters_of(active[0])["stiffness_estimate"])
    else:
        upward = damping, np.linspace(0.0, widest, points)
    drawn = chart(loop, (delay, across), upward)
    return {
        "bode": figures.bode(gain),
        "nyquist": figures.nyquist(gain, {} if first is None else {loop.name: growth_per_contact(first)}),
        "nichols": figures.nichols(gain),
        "roots": figures.root_map({loop.name: roots}),
        "chart": figures.stability_chart(drawn, {"this system": here}),
    }
