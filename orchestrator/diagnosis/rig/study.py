"""Input of a diagnosis: the calibrated rig, and logs of its runs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from ...base.errors import ConfigError, Problem, listed, nearest
from ...base.quantities import Measure, quantity
from ...base.units import UnitError, convert, parse_unit
from ...config import Places, parse
from ..study.mapping import Column, columns_of, read_mapping
from ..study.study import Array, Nominal

_Path = tuple[str | int, ...]

_FORMATS = ("gap-case/1", "gap-study/1")
_KEYS = ("format", "rig", "tick", "nominal", "runs", "experiments")
_NOMINAL_KEYS = ("value", "unit", "tolerance")
_RUN_KEYS = ("file", "role", "mass", "approach_speed")
_COLUMNS = {
    "time": "s",
    "desired_position": "m",
    "desired_velocity": "m/s",
    "encoder_position": "m",
    "sensor_force": "N",
    "compensated_force": "N",
    "stiffness_estimate": "N/m",
}
# What a study may say of an experiment that its lab can make: a contact with other numbers.
_EXPERIMENT = {"mass": "kg", "approach_speed": "m/s", "rod": "1", "tracker": "m", "ticks": "1"}
# Units of what a study states of its rig.
UNITS = {
    "contact_stiffness": "N/m",
    "contact_damping": "N.s/m",
    "front_wall": "m",
    "rear_wall": "m",
    "natural_frequency": "rad/s",
    "damping_ratio": "1",
    "response_delay": "s",
    "sensor_delay": "s",
    "sensor_cutoff": "rad/s",
    "force_bias": "N",
    "force_noise": "N",
    "force_resolution": "N",
    "encoder_noise": "m",
    "encoder_resolution": "m",
}
# Of these, values of any sign, and such as are divided by.
_ANY_SIGN = ("front_wall", "rear_wall", "force_bias")
_POSITIVE = ("contact_stiffness", "natural_frequency", "damping_ratio")


class Role(Enum):
    """Use of a run: fits see only train."""

    TRAIN = "train"
    HELDOUT = "heldout"
    REPEAT = "repeat"


@dataclass(frozen=True)
class Run:
    """One logged run.

    Attributes:
        name: of the file.
        mass: of the satellite software [kg]; approach_speed: [m/s].
        columns: logged signals by name, each of shape (n,), SI, one value per tick.
        path: of the log that it was read from; None if it was not.
    """

    name: str
    role: Role
    mass: float
    approach_speed: float
    columns: Mapping[str, Array]
    path: Path | None = None

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]

    def __len__(self) -> int:
        return len(self.columns["time"])


@dataclass(frozen=True)
class Study:
    """A rig and its runs.

    Attributes:
        tick: of the rig's software [s].
        nominal: by name, SI (angular frequencies in rad/s).
        experiments: that the lab can make beyond the menu, as `menu.Experiment` takes them, SI.
        mapping: of signals to the logs' columns; a signal that is not there has its own name.
    """

    name: str
    tick: float
    nominal: Mapping[str, Nominal]
    runs: tuple[Run, ...]
    experiments: tuple[Mapping[str, Any], ...] = ()
    mapping: Mapping[str, Column] = field(default_factory=dict)

    def noise(self, signal: str) -> float:
        """Standard deviation of a sensor's samples, rounding included, SI.

        Args:
            signal: "encoder" [m] or "force" [N].
        """
        step = self.nominal[f"{signal}_resolution"].value
        return math.hypot(self.nominal[f"{signal}_noise"].value, step / math.sqrt(12.0))

    def of(self, role: Role) -> tuple[Run, ...]:
        """The runs of a role."""
        return tuple(run for run in self.runs if run.role is role)


def case_file(folder: Path) -> Path:
    """The file of a study, from its path or its folder: case.yaml, or else study.yaml."""
    if folder.is_file():
        return folder
    found = (folder / name for name in ("case.yaml", "study.yaml"))
    return next((path for path in found if path.is_file()), folder / "case.yaml")


def load_study(folder: Path) -> Study:
    """Read a case folder (case.yaml and its logs), or a study file.

    A study file has the keys of case.yaml, the format gap-study/1, and `columns`, which says how its logs
    call the signals; see `mapping.Column`. Logs are of any kind that `logs.read_log` reads.

    Raises: ConfigError with all problems at once: missing files, columns, units, numbers that are not finite.
    """
    path = case_file(folder)
    folder = path.parent
    if not path.is_file():
        raise ConfigError(
            [Problem(str(folder), "no case.yaml", "a folder with case.yaml and its logs, or a study.yaml")]
        )
    try:
        data, places = parse(path.read_text(encoding="utf-8"), str(path))
    except (OSError, UnicodeDecodeError) as error:
        what = "is no text" if isinstance(error, UnicodeDecodeError) else f"cannot be read: {error.strerror}"
        allowed = "a folder with case.yaml and its logs, or a study.yaml"
        raise ConfigError([Problem(str(path), what, allowed)]) from None
    problems: list[Problem] = []
    if not isinstance(data, dict):
        raise ConfigError([Problem(str(path), "is no study", "keys and their values, `format` among them")])
    if data.get("format") not in _FORMATS:
        got = data.get("format")
        allowed = listed((*_FORMATS, "port-study/1"))
        config = "This is a system's config; a study names it as `system`." if "instances" in data else ""
        raise ConfigError([Problem(places.text(("format",)), f"got {got!r}", allowed, config)])
    keys = (*_KEYS, *(("columns",) if data["format"] == _FORMATS[1] else ()))
    _known(data, keys, places, (), problems)
    tick = data.get("tick")
    clock: str | None = "tick"
    if not isinstance(tick, int | float) or not 0 < tick < math.inf:
        problems.append(Problem(places.text(("tick",)), f"got {tick!r}", "a positive number of seconds"))
        tick, clock = 1.0, None
    nominal = _nominal(data.get("nominal") or {}, places, problems)
    # The logs of a case call the signals as they are called here.
    mapping = {name: Column(column=name) for name in _COLUMNS}
    if data["format"] == "gap-study/1":
        given = data.get("columns")
        mapping = read_mapping(given, _COLUMNS, places, ("columns",), problems)
        if isinstance(given, dict) and "time" in given:
            clock = None  # also if something is wrong with it
    entries = data.get("runs") or []
    if not isinstance(entries, list):
        problems.append(Problem(places.text(("runs",)), f"got {entries!r}", "a list of runs"))
        entries = []
    runs: list[Run] = []
    for number, entry in enumerate(entries):
        run = _run(folder, entry, number, places, problems, mapping, tick, clock)
        if run is None:
            continue
        if any(run.name == other.name for other in runs):
            place = places.text(("runs", number, "file"))
            problems.append(Problem(place, f"another run is called {run.name}, too", "one name for each run"))
        runs.append(run)
    experiments = _experiments(data.get("experiments") or [], places, problems)
    if not any(run.role is Role.TRAIN for run in runs) and not problems:
        problems.append(Problem(places.text(("runs",)), "no run has the role train", "at least one"))
    if problems:
        raise ConfigError(problems)
    return Study(folder.resolve().name, float(tick), nominal, tuple(runs), experiments, mapping)


def _experiments(data: Any, places: Places, problems: list[Problem]) -> tuple[dict[str, Any], ...]:
    """Experiments of the lab's own: name, description, and numbers with units."""
    found: list[dict[str, Any]] = []
    allowed = ("name", "description", *_EXPERIMENT)
    for number, entry in enumerate(data if isinstance(data, list) else [data]):
        path = ("experiments", number)
        if not isinstance(entry, dict) or not isinstance(entry.get("name"), str):
            problems.append(Problem(places.text(path), "needs a name", listed(allowed)))
            continue
        made: dict[str, Any] = {"name": entry["name"], "description": str(entry.get("description", ""))}
        _known(entry, allowed, places, path, problems)
        for key, value in entry.items():
            if key in _EXPERIMENT:
                unit, where = _EXPERIMENT[key], places.text((*path, key))
                size = quantity("", Measure(unit, parse_unit(unit)), value, where)
                if isinstance(size, Problem):
                    problems.append(size)
                elif not size > 0.0 or (key == "ticks" and (size != int(size) or size < 2)):
                    problems.append(Problem(where, f"got {value!r}", "above 0; ticks whole, from 2"))
                else:
                    made[key] = int(size) if key == "ticks" else size
        found.append(made)
    return tuple(found)


def _known(
    data: Mapping[Any, Any], allowed: Sequence[str], places: Places, path: _Path, problems: list[Problem]
) -> None:
    """Refuse keys that mean nothing, most of them misspelt."""
    problems += [
        Problem(places.text((*path, str(key))), "unknown", listed(allowed), nearest(str(key), allowed))
        for key in data
        if key not in allowed
    ]


def _nominal(data: Any, places: Places, problems: list[Problem]) -> dict[str, Nominal]:
    found: dict[str, Nominal] = {}
    whole = places.text(("nominal",))
    if not isinstance(data, dict):
        problems.append(Problem(whole, f"got {data!r}", f"entries for {listed(tuple(UNITS))}"))
        return found
    _known(data, tuple(UNITS), places, ("nominal",), problems)
    for name, entry in data.items():
        path = ("nominal", name)
        place = places.text(path)
        if name not in UNITS:
            continue
        if not isinstance(entry, dict) or not {"value", "unit"} <= set(entry):
            problems.append(Problem(place, f"got {entry!r}", f"value and unit (as {UNITS[name]}), tolerance"))
            continue
        _known(entry, _NOMINAL_KEYS, places, path, problems)
        try:
            if str(entry["unit"]) == "Hz" and UNITS[name] == "rad/s":
                factor = 2.0 * np.pi  # frequencies of oscillations and filters, which turn once per period
            else:
                factor = convert(parse_unit(str(entry["unit"])), parse_unit(UNITS[name]))[0]
            found[name] = Nominal(float(entry["value"]) * factor, float(entry.get("tolerance", 0)) * factor)
        except UnitError as error:
            problems.append(
                Problem(places.text((*path, "unit")), str(error), f"a unit such as {UNITS[name]}")
            )
            continue
        except (TypeError, ValueError):
            problems.append(Problem(place, f"got {entry!r}", "numbers for value and tolerance"))
            continue
        value, tolerance = found[name].value, found[name].tolerance
        least = 0.0 if name not in _ANY_SIGN else -math.inf
        if not least <= value < math.inf or (name in _POSITIVE and value == 0.0):
            allowed = "above 0" if name in _POSITIVE else "not below 0" if least == 0.0 else "finite"
            where = places.text((*path, "value"))
            problems.append(Problem(where, f"got {entry['value']}", f"a number, {allowed}"))
        if not 0.0 <= tolerance < math.inf:
            where = places.text((*path, "tolerance"))
            problems.append(Problem(where, f"got {entry['tolerance']}", "a number, not below 0"))
    problems += [Problem(whole, f"{name} is missing") for name in UNITS if name not in data]
    walls = [found[name].value for name in ("front_wall", "rear_wall") if name in found]
    if len(walls) == 2 and not walls[0] > walls[1]:
        what = f"front_wall at {walls[0]:g} m is not before rear_wall at {walls[1]:g} m"
        problems.append(Problem(whole, what, "the rod between the two"))
    for signal in ("encoder", "force"):
        pair = (f"{signal}_noise", f"{signal}_resolution")
        if all(name in found and found[name].value == 0.0 for name in pair):
            problems.append(Problem(whole, f"{' and '.join(pair)} are 0", "one of them above 0"))
    return found


def _run(
    folder: Path,
    entry: Any,
    number: int,
    places: Places,
    problems: list[Problem],
    mapping: Mapping[str, Column],
    tick: float,
    clock: str | None,
) -> Run | None:
    before = len(problems)
    at = ("runs", number)
    place = places.text(at)
    if not isinstance(entry, dict):
        problems.append(Problem(place, f"got {entry!r}", listed(_RUN_KEYS)))
        return None
    _known(entry, _RUN_KEYS, places, at, problems)
    problems += [
        Problem(place, f"{key} is missing", listed(_RUN_KEYS)) for key in _RUN_KEYS if key not in entry
    ]
    roles = [one.value for one in Role]
    if "role" in entry and entry["role"] not in roles:
        problems.append(Problem(places.text((*at, "role")), f"got {entry['role']!r}", listed(roles)))
    for key in ("mass", "approach_speed"):
        if key in entry and not isinstance(entry[key], int | float):
            problems.append(Problem(places.text((*at, key)), f"got {entry[key]!r}", "a number"))
    if len(problems) > before:
        return None
    file, role = str(entry["file"]), Role(entry["role"])
    mass, speed = float(entry["mass"]), float(entry["approach_speed"])
    if not 0.0 < mass < math.inf:
        problems.append(Problem(places.text((*at, "mass")), f"got {mass}", "a positive mass [kg]"))
    if not math.isfinite(speed) or speed == 0.0:
        where = places.text((*at, "approach_speed"))
        problems.append(Problem(where, f"got {speed}", "a speed other than 0 [m/s]"))
    path = folder / file
    if not path.exists():
        there = [one.name for one in path.parent.iterdir()] if path.parent.is_dir() else []
        what = f"no file {path.name} in {path.parent}"
        problems.append(Problem(places.text((*at, "file")), what, remedy=nearest(path.name, there)))
    if len(problems) > before:
        return None
    columns = columns_of(path, mapping, _COLUMNS, tick, problems, clock=clock)
    # Logs of several folders may be called the same.
    name = (PurePath(file).parent / path.name.partition(".")[0]).as_posix()
    return None if columns is None else Run(name, role, mass, speed, columns, path)
