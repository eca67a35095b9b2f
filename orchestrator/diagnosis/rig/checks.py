"""Check logs before anything is fitted: distinguish bad data from a bad model."""

from __future__ import annotations

import numpy as np

from ...base.errors import Problem
from ..study.channels import clipped, frozen, logged_twice
from ..study.log_checks import clock_of_stamps, clock_slack
from ..study.mistakes import Mistake, merged_problems
from .consistency import check_columns
from .motion import STOP, contacts
from .study import Array, Role, Run, Study

# Of a tick; stamps are rounded to the log's digits.
_LATE = 0.5
_FEWEST_ROWS = 100
# See `_masses`: runs to compare with at least, by how much these may differ, by how much one has to, and
# least squared correlation of force and acceleration for an estimate of the mass.
_FEWEST_OTHERS, _AGREE, _OFF, _FOLLOWS = 4, 2e-3, 0.02, 0.98
_FEWEST_CONTACTS = 3
_MOVING = ("desired_position", "desired_velocity", "encoder_position", "sensor_force", "compensated_force")


def check_logs(study: Study) -> tuple[list[Problem], list[Problem]]:
    """Check the logs of a study.

    Returns: what forbids a diagnosis, and what a reader should be warned of; each with run, column, row,
        value and remedy.
    """
    refused: list[Problem] = []
    warned: list[Problem] = []
    for run in study.runs:
        wrong = _time(study, run) or _still(run)
        if not wrong:
            wrong = check_columns(study, run)
        refused += wrong
        if not wrong:
            warned += _stuck(run)
    warned = merged_problems(warned, "{} more of this kind in this column")
    refused = merged_problems(refused, "the same in {} more run{s}", Mistake)
    if not refused:
        refused += _twice(study) + _masses(study)
    if not refused:
        warned += _ended_early(study)
        fewest, few = _contacts(study)
        refused += fewest
        warned += few + _repeats(study)
    return refused, warned


def _twice(study: Study) -> list[Problem]:
    compared = ("encoder_position", "sensor_force")
    runs = [(run.name, {name: run[name] for name in compared}) for run in study.runs]
    return list(logged_twice(runs, "runs"))


def _masses(study: Study) -> list[Problem]:
    """A run whose satellite moved as with another mass, while all others agree with theirs.

    What an effect does to the mass it does in all runs, as a factor or by an amount: both are fitted to the
    other runs.
    """
    moved = [_mass(study, run) for run in study.runs]
    stated = np.array([run.mass for run in study.runs])
    found = []
    for number, run in enumerate(study.runs):
        others = [at for at, mass in enumerate(moved) if at != number and mass is not None]
        mass = moved[number]
        if mass is None or len(others) < _FEWEST_OTHERS:
            continue
        basis = np.stack([stated, np.ones(len(stated))], axis=1)
        masses = np.array([moved[at] for at in others], float)
        law = np.linalg.lstsq(basis[others], masses, rcond=None)[0]
        expected = basis @ law
        if (
            np.abs(masses / expected[others] - 1.0).max() > _AGREE
            or abs(mass / expected[number] - 1.0) < _OFF
        ):
            continue
        found.append(
            Problem(
                f"{run.name}: mass",
                f"got {run.mass:g} kg, but it moves as with {mass:.6g} kg; the other runs agree with theirs",
                remedy="Correct its mass, or name the log that was meant.",
            )
        )
    # Where several deviate, it is no slip of the pen.
    return found if len(found) == 1 else []


def _mass(study: Study, run: Run) -> float | None:
    """Mass in the satellite's software [kg]: force over acceleration; None if it cannot be estimated."""
    force = run["compensated_force"][:-1]
    speed = np.diff(run["desired_velocity"]) / study.tick
    power = float(speed @ speed)
    if power == 0.0 or float(force @ speed) ** 2 < _FOLLOWS * power * float(force @ force):
        return None
    return float(force @ force) / float(force @ speed)


def _time(study: Study, run: Run) -> list[Problem]:
    """Time stamps: as many as needed, in order, each once, without gaps, at the study's tick."""
    time, tick = run["time"], study.tick
    place = f"{run.name}: column time"
    if len(time) < _FEWEST_ROWS:
        return [
            Problem(run.name, f"has {len(time)} rows", f"at least {_FEWEST_ROWS}", "Log the run to its end.")
        ]
    steps = np.diff(time)
    typical = float(np.median(steps))
    if typical > 0 and abs(typical / tick - 1.0) > 0.05:
        factor = typical / tick
        return [
            Problem(
                place,
                f"rows are {typical:.6g} s apart, the tick is {tick:g} s ({factor:.4g} times)",
                remedy="Correct the unit of the time, or `tick`.",
            )
        ]
    found = []
    repeated = np.flatnonzero(steps == 0.0)
    if repeated.size:
        found.append(
            _at(place, repeated[0] + 1, time, f"{len(repeated)} stamps stand twice", "Remove the second row.")
        )
    back = np.flatnonzero(steps < 0.0)
    if back.size:
        found.append(
            _at(place, back[0] + 1, time, "time runs backwards", "Sort the rows by time, and look why.")
        )
    gaps = np.flatnonzero(steps > (1.0 + _LATE) * tick)
    # A row out of order leaves a gap where it belongs; it is reported once.
    if gaps.size and not back.size:
        row = int(gaps[0]) + 1
        lost = round(float(steps[gaps].sum()) / tick) - len(gaps)
        found.append(
            _at(
                place,
                row,
                time,
                f"{lost} rows are missing in {len(gaps)} places, the first {steps[row - 1]:.6g} s long",
                "Log every tick: replays need each input.",
            )
        )
    # Each step may be right to half of it, and their sum be far off.
    if not found and abs(time[-1] - time[0] - tick * (len(time) - 1)) > clock_slack(len(time), tick):
        remedy = "Correct `tick`, or the clock that the stamps are of."
        found.append(Problem(place, clock_of_stamps(time, tick), remedy=remedy))
    return found


def _at(place: str, row: int, values: Array, what: str, remedy: str) -> Problem:
    return Problem(place, f"row {int(row)} ({values[int(row)]:.9g}): {what}", remedy=remedy)


def _still(run: Run) -> list[Problem]:
    """Columns that never change."""
    return [
        Problem(
            f"{run.name}: column {name}",
            f"rows 0 to {len(run) - 1} are all {run[name][0]:.9g}",
            remedy="The channel is dead or not connected; log it, or leave the run out.",
        )
        for name in _MOVING
        if np.ptp(run[name]) == 0.0
    ]


def _stuck(run: Run) -> list[Problem]:
    """Channels that are clipped or frozen for a while."""
    found = []
    for name in _MOVING:
        values = run[name]
        stretches = clipped(values) if name in ("encoder_position", "sensor_force") else []
        # Coarse steps, or no noise: a force at rest is recognised by equal values.
        if "force" not in name or np.median(np.abs(np.diff(values))) != 0.0:
            stretches += frozen(values)
        found += [Problem(f"{run.name}: column {name}", one.what, remedy=one.remedy) for one in stretches]
    return found


def _ended_early(study: Study) -> list[Problem]:
    """Runs that end much earlier than others, although they stayed within their range."""
    longest = max(len(run) for run in study.runs)
    return [
        Problem(
            run.name,
            f"ends at row {len(run) - 1} ({run['encoder_position'][-1]:.6g} m); others have {longest} rows",
            remedy="Was it left early? It counts as far as it goes.",
        )
        for run in study.runs
        if len(run) < 0.7 * longest and np.max(np.abs(run["encoder_position"])) < 0.9 * STOP
    ]


def _contacts(study: Study) -> tuple[list[Problem], list[Problem]]:
    counts = {run.name: len(contacts(study, run)) for run in study.of(Role.TRAIN)}
    total = sum(counts.values())
    counted = ", ".join(f"{name} {count}" for name, count in counts.items())
    problem = Problem(
        "runs of the role train",
        f"{total} contacts in all ({counted})",
        remedy="Run longer, or faster: effects of contact and sensor show in contacts only.",
    )
    if total == 0:
        return [problem], []
    return [], [problem] if total < _FEWEST_CONTACTS else []


def _repeats(study: Study) -> list[Problem]:
    """Repeats are compared with held-out runs of the same mass and speed."""
    found = []
    heldout = {(run.mass, run.approach_speed) for run in study.of(Role.HELDOUT)}
    for run in study.of(Role.REPEAT):
        if (run.mass, run.approach_speed) not in heldout:
            found.append(
                Problem(
                    run.name,
                    f"repeats no held-out run: mass {run.mass:g} kg, speed {run.approach_speed:g} m/s",
                    remedy="Give it the mass and the speed of the run that it repeats.",
                )
            )
    return found
