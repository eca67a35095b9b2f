"""Whether the columns of a log are consistent, and which single mistake explains it if not.

What the rig's software computes from its own inputs holds whatever effect is hidden in the rig. Where it does
not hold, every column in turn is tried with another sign or unit, exchanged for another, or shifted in time;
the mistake that explains everything is named.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import chain, combinations

import numpy as np

from ...base.errors import Problem
from ..study.mistakes import Mistake, wrong_factors
from .rig import IN_CONTACT
from .software import ControllerReplay, resolution, ways
from .study import Array, Run, Study

Columns = Mapping[str, Array]
_SHIFTS = 50
# Ticks over which ways are compared, and by how much ways and speeds may differ and be of one satellite.
_TOGETHER, _OFF = 50, 0.1
# Effects that come to mind change the satellite's mass by less than these.
_MASS = (0.4, 2.5)
# A controller that does something of its own out of contact still gives about the force, contacts included:
# with such a gain, and such a correlation.
_GAIN, _ALIKE = (0.3, 3.0), 0.8
# Range of the contact's stiffness from force over penetration; sensors and frames may be far from nominal.
_STIFFNESS = (0.05, 20.0)
_ESTIMATE = (0.3, 2.5)


@dataclass(frozen=True)
class _Broken:
    """A violated relation: its columns, where it is first violated, and how.

    Attributes:
        gross: whether by so much that the columns cannot be what they are said to be. A single mistake in
            them may show in less; but so may software that does not do what it is believed to.
    """

    columns: tuple[str, ...]
    row: int
    what: str
    gross: bool = True


def check_columns(study: Study, run: Run) -> list[Problem]:
    """Contradictions between the columns of a run, with column, row and remedy."""
    broken = _broken(study, run)
    if not broken:
        return _clock_of_encoder(study, run)
    suspects = sorted({name for one in broken for name in one.columns})
    for remedy, believed, corrected in chain(_misstated(study, run), _mistakes(study, run, suspects)):
        if not _broken(believed, corrected):
            first = min(one.row for one in broken)
            return [
                Mistake(
                    f"{run.name}: {remedy[0]}",
                    f"from row {first} onwards the columns contradict each other: {broken[0].what}",
                    remedy=remedy[1],
                )
            ]
    return [
        Problem(
            f"{run.name}: {' and '.join(one.columns)}",
            f"row {one.row}: {one.what}",
            remedy="Look at signs, units, order and clocks of these columns; no single mistake explains it.",
        )
        for one in broken
        if one.gross
    ]


def _broken(study: Study, run: Run) -> list[_Broken]:
    found = []
    for relation in _RELATIONS:
        one = relation(study, run)
        if one is not None:
            found.append(one)
    return found


def _misstated(study: Study, run: Run) -> Iterator[tuple[tuple[str, str], Study, Run]]:
    """Mistakes in the description of rig and run: place and remedy, and study and run without them."""
    stated = study.nominal["contact_stiffness"]
    for factor in (1e3, 1e-3, 1e6, 1e-6):
        less = replace(stated, value=stated.value / factor)
        believed = replace(study, nominal={**study.nominal, "contact_stiffness": less})
        remedy = f"All fits if it is {less.value:g} N/m. Correct its unit or value in the study."
        yield ("nominal.contact_stiffness", remedy), believed, run
    speed = float(run["desired_velocity"][0])
    if speed:
        remedy = f"All fits if it is {speed:g} m/s, as desired_velocity begins. Correct it in the study."
        yield ("approach_speed", remedy), study, replace(run, approach_speed=speed)


def _mistakes(study: Study, run: Run, suspects: list[str]) -> Iterator[tuple[tuple[str, str], Study, Run]]:
    """Single mistakes in the log as column and remedy, and the study and the run without them."""
    for name in suspects:
        column = study.mapping.get(name)
        for factor, remedy in wrong_factors(column.sign, column.unit) if column else wrong_factors():
            corrected = {**run.columns, name: run[name] / factor}
            yield (f"column {name}", remedy), study, replace(run, columns=corrected)
    names = [name for name in run.columns if name != "time"]
    for one, other in combinations(names, 2):
        if one in suspects or other in suspects:
            corrected = {**run.columns, one: run[other], other: run[one]}
            yield (
                (f"columns {one}, {other}", "All fits if the two are exchanged. Exchange their headers."),
                study,
                replace(run, columns=corrected),
            )
    for name in suspects:
        for shift in sorted(range(-_SHIFTS, _SHIFTS + 1), key=abs):
            if shift and len(run) > 3 * _SHIFTS:
                yield (f"column {name}", _clock(shift)), study, _shifted(run, name, shift)


def _clock(shift: int) -> str:
    way = "late" if shift > 0 else "early"
    return f"All fits if it comes {abs(shift)} ticks {way}. Correct the offset of its clock."


def _shifted(run: Run, name: str, shift: int) -> Run:
    """The rows in which all columns are known once one of them is moved `shift` ticks towards the past."""
    count = len(run) - abs(shift)
    late, other = (shift, 0) if shift > 0 else (0, -shift)
    columns = {
        key: values[late : late + count] if key == name else values[other : other + count]
        for key, values in run.columns.items()
    }
    return replace(run, columns=columns)


# Relations. Each returns the first contradiction, or None.


def _way_of_velocity(study: Study, run: Run) -> _Broken | None:
    position, velocity = run["desired_position"], run["desired_velocity"]
    expected = ways(velocity, study.tick)
    left = np.abs(np.diff(position) - expected)
    size = float(np.sqrt(np.mean(np.square(expected))))
    # Rounding explains no more than a small part of the way.
    floor = min(resolution(position) + study.tick * resolution(velocity), 0.05 * size)
    if np.sqrt(np.mean(np.square(left))) <= 2e-3 * size + floor:
        return None
    row = int(np.argmax(left > 2e-3 * size + 3.0 * floor))
    # Over some ticks, since single ones may be measured as the software counts its time.
    moved, meant = (np.convolve(one, np.ones(_TOGETHER), "valid") for one in (np.diff(position), expected))
    slope, alike = _line(meant, moved)
    return _Broken(
        ("desired_position", "desired_velocity"),
        row,
        f"desired_position moves by {position[row + 1] - position[row]:.6g} m in a tick, "
        f"desired_velocity by {expected[row]:.6g} m",
        gross=abs(slope - 1.0) > _OFF or alike < 1.0 - _OFF,
    )


def _force_of_velocity(study: Study, run: Run) -> _Broken | None:
    body = run.mass * np.diff(run["desired_velocity"]) / study.tick
    force = run["compensated_force"][:-1]
    columns = ("desired_velocity", "compensated_force")
    slope, correlation = _line(force, body)
    row = int(np.argmax(np.abs(force)))
    # The noise of the sensor passes through, so that the clocks can be compared to one tick.
    changes, pushes = np.diff(body), np.diff(force)
    # A body that swings on the satellite follows later: the second differences show the rigid part alone.
    passed, at_once = max(
        _line(pushes, changes), _line(np.diff(pushes), np.diff(changes)), key=lambda line: line[1]
    )
    # What else pushes the satellite, as a cable does, is slow.
    alike = _MASS[0] <= slope <= _MASS[1] and correlation >= 0.8
    if not alike and not (_MASS[0] <= passed <= _MASS[1] and at_once >= 0.9):
        return _Broken(
            columns,
            row,
            f"compensated_force is {force[row]:.6g} N where desired_velocity implies {body[row]:.6g} N "
            f"(mass {run.mass:g} kg)",
        )
    lag = _lag(pushes, changes)
    if lag and at_once < 0.9:
        return _Broken(columns, row, f"desired_velocity follows compensated_force {lag} ticks off")
    sensor = run["sensor_force"][:-1]
    left, other = (float(np.std(body - _line(one, body)[0] * one)) for one in (force, sensor))
    if other < 0.2 * left:
        return _Broken(columns, row, "desired_velocity follows sensor_force, not compensated_force")
    if at_once < 0.3:
        return _Broken(columns, row, "desired_velocity does not follow the changes of compensated_force")
    return None


def _force_out_of_contact(study: Study, run: Run) -> _Broken | None:
    sensor, out = run["sensor_force"], run["compensated_force"]
    free = np.flatnonzero(np.abs(sensor) <= IN_CONTACT)
    if len(free) < 20:
        rows = np.argsort(np.abs(sensor))[:20]
        row = int(rows.min())
        what = f"sensor_force is never below {IN_CONTACT:g} N; row {row} has {sensor[row]:.6g} N"
        return _Broken(("sensor_force",), row, what)
    wrong = free[np.abs(out - sensor)[free] > 1e-3 + resolution(sensor)]
    if len(wrong) <= 0.2 * len(free):
        return None
    row = int(wrong[0])
    slope, correlation = _line(sensor, out)
    return _Broken(
        ("sensor_force", "compensated_force"),
        row,
        f"out of contact the controller passes the force on, but sensor_force is {sensor[row]:.6g} N and "
        f"compensated_force {out[row]:.6g} N",
        gross=not _GAIN[0] <= slope <= _GAIN[1] or correlation < _ALIKE,
    )


def _first_motion(study: Study, run: Run) -> _Broken | None:
    """The robot begins as fast as its command, in its direction."""
    count = min(len(run), 60)
    time, commanded = run["time"][:count], run["desired_position"][:count]
    speed, wanted = (
        float(np.polyfit(time, one[:count], 1)[0]) for one in (run["encoder_position"], commanded)
    )
    if abs(wanted) < 0.2 * abs(run.approach_speed) or 0.3 <= speed / wanted <= 3.0:
        return None
    return _Broken(
        ("encoder_position", "desired_position"),
        0,
        f"encoder_position begins at {speed:.6g} m/s, desired_position at {wanted:.6g} m/s",
    )


def _push_against_way(study: Study, run: Run) -> _Broken | None:
    """Whether in contact the force opposes the penetration with about the contact's stiffness."""
    force, way = run["sensor_force"], run["encoder_position"]
    strong = np.abs(force) > 0.5 * np.max(np.abs(force))
    walls = study.nominal["front_wall"].value, study.nominal["rear_wall"].value
    if np.max(np.abs(force)) < 20.0 * study.nominal["force_noise"].value + 5.0 or strong.sum() < 5:
        return None
    middle, half = 0.5 * (walls[0] + walls[1]), 0.5 * (walls[0] - walls[1])
    side = np.sign(way - middle)
    row = int(np.argmax(np.abs(force)))
    depth = np.abs(way - middle) - half
    columns = ("sensor_force", "encoder_position")
    if np.mean(force[strong] * side[strong] < 0) < 0.2:
        return _Broken(
            columns, row, f"sensor_force is {force[row]:.6g} N where the rod is at {way[row]:.6g} m: it pulls"
        )
    # Between the weakest and the strongest push of a contact, and so wherever the wall is.
    span = float(np.ptp(way[strong & (side > 0)]) if (strong & (side > 0)).any() else np.ptp(way[strong]))
    change = float(
        np.ptp(force[strong & (side > 0)]) if (strong & (side > 0)).any() else np.ptp(force[strong])
    )
    stiffness = study.nominal["contact_stiffness"].value
    ratio = change / (stiffness * max(span, 1e-12))
    if _STIFFNESS[0] <= ratio <= _STIFFNESS[1]:
        return None
    return _Broken(
        columns,
        row,
        f"sensor_force is {force[row]:.6g} N at a depth of {depth[row]:.6g} m: {ratio:.3g} times as stiff as "
        "calibrated",
    )


def _estimate(study: Study, run: Run) -> _Broken | None:
    estimate, stiffness = run["stiffness_estimate"], study.nominal["contact_stiffness"].value
    wrong = np.flatnonzero((estimate < _ESTIMATE[0] * stiffness) | (estimate > _ESTIMATE[1] * stiffness))
    if not wrong.size:
        return None
    row = int(wrong[0])
    return _Broken(
        ("stiffness_estimate",),
        row,
        f"stiffness_estimate is {estimate[row]:.6g} N/m, calibrated {stiffness:.6g} N/m",
    )


def _begin(study: Study, run: Run) -> _Broken | None:
    speed = run["desired_velocity"][0]
    if abs(speed - run.approach_speed) <= 0.05 * abs(run.approach_speed):
        return None
    return _Broken(
        ("desired_velocity",),
        0,
        f"desired_velocity begins at {speed:.6g} m/s, the approach speed is {run.approach_speed:g} m/s",
    )


_RELATIONS: tuple[Callable[[Study, Run], _Broken | None], ...] = (
    _way_of_velocity,
    _begin,
    _force_out_of_contact,
    _force_of_velocity,
    _first_motion,
    _push_against_way,
    _estimate,
)


def _clock_of_encoder(study: Study, run: Run) -> list[Problem]:
    """Only the controller's arithmetic says how old the encoder's reading is, if nothing is hidden in it."""

    def misfit(one: Run) -> float:
        replay = ControllerReplay(study, [one])
        left = np.abs(replay.residuals({}, (), np.zeros(0))[0])
        return float(np.sqrt(np.mean(np.square(left))))

    now = misfit(run)
    if now < 10.0 or len(run) <= 3 * _SHIFTS:
        return []
    for shift in (one for size in range(1, 21) for one in (size, -size)):
        moved = np.roll(run["encoder_position"], -shift)
        if shift > 0:
            moved[-shift:] = moved[-shift - 1]
        else:
            moved[:-shift] = moved[-shift] - run.approach_speed * study.tick * np.arange(-shift, 0, -1)
        if misfit(replace(run, columns={**run.columns, "encoder_position": moved})) < 0.02 * now:
            row = int(np.argmax(np.abs(run["sensor_force"]) > IN_CONTACT))
            return [
                Mistake(
                    f"{run.name}: column encoder_position",
                    f"from row {row} onwards the controller's output does not follow from it",
                    remedy=_clock(shift),
                )
            ]
    return []


def _lag(x: Array, y: Array) -> int:
    """Delay of y behind x [samples], within `_SHIFTS`, by correlation."""
    size = 2 * len(x)
    product = np.fft.irfft(np.fft.rfft(y - y.mean(), size) * np.conj(np.fft.rfft(x - x.mean(), size)), size)
    lags = np.arange(-_SHIFTS, _SHIFTS + 1)
    return int(lags[np.argmax(product[lags])])


def _line(x: Array, y: Array) -> tuple[float, float]:
    """Slope of y over x, and their correlation; zero where one does not change."""
    dx, dy = x - x.mean(), y - y.mean()
    xx, yy, xy = float(dx @ dx), float(dy @ dy), float(dx @ dy)
    if xx <= 0.0 or yy <= 0.0:
        return 0.0, 0.0
    return xy / xx, xy / float(np.sqrt(xx * yy))
