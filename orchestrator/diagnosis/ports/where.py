"""Where the gap of a system lies: by component, phase of motion and band, and by shares of the loop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ...system.connection import Port
from ..finding import Finding
from ..sharing import by_place, cells, coalitions, shapley_values, white_cells
from ..study import Array
from ..verdict import Warned
from .apart import Apart, Window, closed, components, estimates, modelled
from .motion import phases
from .study import PortRun, PortStudy, Role

__all__ = ["Shares", "lasting", "ledger", "no_shares", "shapley_shares", "where"]

# Edges of the bands, as shares of the sampling frequency.
_BANDS = (0.0, 0.002, 0.01, 0.05)
# Runs of noise alone, from which the energy that noise leaves is reported.
_DRAWS, _SEED = 2, 20190611
# Energies beyond the noise are shared out where they are more than so many times what they scatter by.
_CHANCE = 3.0
# Windows that the loop is closed in at most, and runs for that over all coalitions.
_WINDOWS, _RUNS = 24, 400
_MOST = 6
# Windows through which measured signals lead before one, as tried; all of them, of a run that has no more
# than so many; what may be lost so, in squares of the noise, and what is worth a word.
_LEADS, _ALL, _LOST, _MUCH = (1, 2, 4, 8, 16), 100, 0.1, 1.0


def _among(study: PortStudy) -> tuple[PortRun, ...]:
    return study.of(Role.HELDOUT) or study.of(Role.TRAIN)


def lasting(study: PortStudy, finding: Finding) -> tuple[PortStudy, list[Warned]]:
    """The study with as many windows to lead through as its components need, and those that need more.

    What a component remembers that no start value takes up is lost with each window. What that makes is told
    by signals of the model itself, without noise: its components, taken apart, leave nothing of them but
    that.

    Returns: the study; warnings of components of which much is lost all the same.
    """
    run, base = _among(study)[0], finding.faultless(study.nominal)
    own = closed(study)
    bare = modelled(own, run, base)
    logs = {port: bare.get(port, values) for port, values in run.logs.items()}
    run = replace(run, logs=logs)
    found: dict[int, dict[str, _Loss]] = {}
    size, count = 0.0, 1
    for leads in (*_LEADS, _ALL):
        if leads == _ALL < count:
            break
        apart = Apart(replace(own, leads=leads), run, {**bare, **logs}, base)
        found[leads], window, count = _lost(apart), apart.windows[-1], len(apart.windows)
        size = study.interval * (window.end - window.begin)
        if _most(found[leads]) < _LOST or leads >= count:
            break
    # What more of a lead does not lessen is lost otherwise: where signals jump between samples, say.
    least = min(map(_most, found.values()))
    best = next(leads for leads in found if _most(found[leads]) <= least + _LOST)
    why = "is driven by what happens between samples"
    if best < count:
        more = f", or {why}" if study.parts > 1 else ""
        why = f"remembers more than the {best * size:.3g} s before a window of {size:.3g} s{more}"
    told = [
        Warned(
            place=name,
            what=f"{why}: what is lost so makes {lost**0.5:.2g} times the noise, and where the gap lies "
            "is told worse",
            remedy="Set a longer `window`; or let outputs of the FMU's states take start values.",
        )
        for name, lost in ((name, loss.median) for name, loss in found[best].items())
        if lost > _MUCH
    ]
    return replace(study, leads=best), told


class _Loss(NamedTuple):
    """Mean square of residuals over that of the noise: over all windows, and in the median one."""

    mean: float
    median: float


def _most(found: Mapping[str, _Loss]) -> float:
    # A component that runs away in some window loses everything.
    return max((one.mean if np.isfinite(one.mean) else np.inf for one in found.values()), default=0.0)


def _lost(apart: Apart) -> dict[str, _Loss]:
    """What is left of each component, of its worst port.

    Only some windows may come after what a component remembers, as a controller's integral that is reset: the
    mean tells. Where a run begins, signals may jump between samples, which is no memory: the median tells.
    """
    squares: dict[Port, list[float]] = {}
    for window in apart.windows:
        for port, values in apart.residuals(window).items():
            if port in apart.study.compared:
                noise = float(apart.study.columns[port].noise or 0.0)
                kept = values[window.begin - window.lead :] / noise
                squares.setdefault(port, []).append(float(np.mean(kept**2)))
    names = {port: one.name for one in apart.components for port in one.ports}
    found: dict[str, _Loss] = {}
    for port, values in squares.items():
        loss = _Loss(float(np.mean(values)), float(np.median(values)))
        found[names[port]] = max(found.get(names[port], loss), loss)
    return found


def ledger(study: PortStudy, finding: Finding) -> list[dict[str, Any]]:
    """Excess residual energy by component, phase of motion and band, as shares of all of it.

    Each component is driven by measured signals and taken up anew in each window (see `Apart`), by the
    answer's calibration without its effects; signals that were not logged are those of the answer. What noise
    leaves is told by runs of the same model with noise as specified, and a port's residual counts relative to
    that.

    Returns: rows with component, phase, band, share, which add up to 1; negative where there is less than
        noise leaves. Empty if no more energy is in excess than noise leaves by chance.
    """
    base = finding.faultless(study.nominal)
    step = study.interval
    edges = (*(share / step for share in _BANDS), np.inf)
    rng = np.random.default_rng(_SEED)
    total: dict[tuple[str, str, int], float] = {}
    chance = 0.0
    for run in _among(study):
        signals = estimates(study, run, finding.answer)
        names, labels = phases(study, run, signals)
        grid = _Grid(labels[max(study.settled, 1) :], len(names), edges, step)
        measured = _energies(Apart(closed(study), run, signals, base), grid)
        bare = modelled(closed(study), run, base)
        drawn = []
        for one in (_noisy(study, run, bare, rng) for _ in range(_DRAWS)):
            told = {port: one.logs.get(port, bare[port]) for port in bare}
            drawn.append(_energies(Apart(closed(study), one, told, base), grid))
        for (name, port), (energy, _) in measured.items():
            noise = np.mean([one[name, port].cells for one in drawn], axis=0)
            scatter = float(np.mean([one[name, port].scatter for one in drawn]))
            if not np.isfinite(noise).all():
                noise, scatter = white_cells(float(study.columns[port].noise or 0.0), *grid), 0.0
            # What is taken off, a mean of draws, scatters too.
            chance += scatter / float(noise.sum()) ** 2 * (1.0 + 1.0 / _DRAWS)
            for (phase, band), value in np.ndenumerate((energy - noise) / noise.sum()):
                cell = name, names[phase], band
                total[cell] = total.get(cell, 0.0) + float(value)
    whole = sum(total.values())
    if not np.isfinite(whole) or whole <= _CHANCE * chance**0.5:
        return []
    return [
        {"component": name, "phase": phase, "band": _band(edges, band), "share": value / whole}
        for (name, phase, band), value in total.items()
    ]


def _band(edges: tuple[float, ...], band: int) -> str:
    low, high = edges[band : band + 2]
    return f"{low:.3g}-{high:.3g} Hz" if np.isfinite(high) else f"over {low:.3g} Hz"


class _Grid(NamedTuple):
    """Samples' phases, how many phases there are, edges of the bands [Hz], and the step [s]; see `cells`."""

    labels: np.ndarray
    phases: int
    edges: tuple[float, ...]
    step: float


class _Energy(NamedTuple):
    """Energy of a port's residuals, see `cells`, and what the sum of it scatters by, squared.

    Windows are taken up at measured signals, so that noise there goes through each as a whole: they say what
    the sum scatters by, and samples do not.
    """

    cells: Array
    scatter: float


def _energies(apart: Apart, grid: _Grid) -> dict[tuple[str, Port], _Energy]:
    """Energy of the residuals over all windows, one after the other, by component and compared port."""
    found: dict[Port, list[Array]] = {}
    for window in apart.windows:
        residuals = apart.residuals(window)
        for port in apart.ports:
            if port in apart.study.compared and port in apart.run.logs:
                found.setdefault(port, []).append(residuals[port][window.begin - window.lead :])
    names = {port: one.name for one in apart.components for port in one.ports}
    return {
        (names[port], port): _Energy(
            cells(np.concatenate(parts), *grid), len(parts) * float(np.var([one @ one for one in parts]))
        )
        for port, parts in found.items()
    }


def _noisy(study: PortStudy, run: PortRun, bare: Mapping[Port, Array], draw: np.random.Generator) -> PortRun:
    """A run as the model makes it, with noise as specified; what is given to it as logged."""
    logs = dict(run.logs)
    for port in study.compared:
        if port in logs:
            logs[port] = bare[port] + float(study.columns[port].noise or 0.0) * draw.standard_normal(len(run))
    return replace(run, logs=logs)


@dataclass(frozen=True)
class Shares:
    """Shapley values of a system's components.

    Attributes:
        values: by how much the measured residual of each, injected, lessens the gap, shape (components,).
            They add up to `gap - left`.
        gap, left: mean square of model minus log over the spread of the log, over the windows, without
            residuals and with all injected.
        windows: how many.
    """

    values: Array
    gap: float
    left: float
    windows: int


def no_shares(study: PortStudy) -> str:
    """Why the loop's gap cannot be shared out; "" if it can."""
    found = components(study)
    if len(found) < 2:
        return "one component alone has measured outputs; the gap is its own"
    if len(found) > _MOST:
        return f"{len(found)} components make {2 ** len(found)} coalitions; at most {_MOST} components"
    ports = {port for one in found for port in one.ports}
    for connection in study.prepared.system.connections:
        if connection.wire is not None and len(connection.wire.legs) > 1 and ports & set(connection.sources):
            return f"{connection} adds up several outputs"
    return ""


def shapley_shares(study: PortStudy, finding: Finding) -> Shares:
    """Share out the gap between the closed loop of the answer's calibration, without its effects, and runs.

    Each window is run from the measured state, once per coalition of components whose measured residuals are
    injected: over whole runs model and log would fall out of step, and residuals act at wrong times.
    """
    base = finding.faultless(study.nominal)
    count = len(components(study))
    every = coalitions(count)
    worth = dict.fromkeys(every, 0.0)
    runs = _among(study)
    each = max(min(_WINDOWS, _RUNS // len(every)) // len(runs), 1)
    windows = 0
    for run in runs:
        apart = Apart(closed(study), run, estimates(study, run, finding.answer), base)
        chosen = np.unique(np.linspace(0, len(apart.windows) - 1, each).round().astype(int))
        for window in (apart.windows[place] for place in chosen):
            residuals = apart.residuals(window)
            gaps = {one: _gap(study, run, apart.ahead(window, residuals, one), window) for one in every}
            if np.isfinite(list(gaps.values())).all():
                worth = {one: worth[one] + gaps[one] for one in every}
                windows += 1
    worth = {one: value / max(windows, 1) for one, value in worth.items()}
    return Shares(shapley_values(worth, count), worth[every[0]], worth[every[-1]], windows)


def _gap(study: PortStudy, run: PortRun, given: Mapping[Port, Array], window: Window) -> float:
    squares = []
    for port in study.compared:
        if port in run.logs:
            spread = float(np.std(run.logs[port][study.settled :])) or 1.0
            left = (given[port] - run.logs[port][window.begin : window.end]) / spread
            squares.append(float(np.mean(left**2)))
    return float(np.mean(squares))


def where(study: PortStudy, finding: Finding) -> dict[str, float]:
    """Shares of the closed-loop gap by place, adding up to 1; see `sharing.by_place`.

    Negative where a component hides another's part. Equal ones where there is no gap; none where the model
    runs away in every window.
    """
    found = shapley_shares(study, finding)
    if not found.windows:
        return {}
    values = found.values
    total = float(values.sum())
    shares = (values / total if total > 0.0 else np.full(len(values), 1.0 / len(values))).tolist()
    return by_place(shares, {one.name: one.places for one in components(study)}, finding)
