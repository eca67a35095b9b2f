"""Which effects there are, and the effect of a config."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Mapping
from functools import cache
from importlib import import_module, metadata, util
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from pydantic import ValidationError

from ..base.errors import Problem, listed, nearest
from ..base.quantities import Measure, infinite_quantity, quantity
from ..base.units import parse_unit
from .base import Effect, OfSignal, Pure, per_unit

# Name in configs -> where it lives; imported when asked for. The native loop knows them by their order.
BUILT_IN = {
    "gain": ".gain:Gain",
    "offset": ".offset:Offset",
    "delay": ".delay:Delay",
    "low-pass": ".low_pass:LowPass",
    "sample-and-hold": ".sample_and_hold:SampleAndHold",
    "saturate": ".saturate:Saturate",
    "quantise": ".quantise:Quantise",
    "rate-limit": ".rate_limit:RateLimit",
    "dead-band": ".dead_band:DeadBand",
    "backlash": ".backlash:Backlash",
    "noise": ".noise:Noise",
    "drift": ".drift:Drift",
    "dropout": ".dropout:Dropout",
    "jitter": ".jitter:Jitter",
    "map": ".map:Map",
    "relay": ".relay:Relay",
}
_GROUP = "orchestrator.effects"


class Chosen(NamedTuple):
    """An effect with what the config says of its place.

    Attributes:
        effect: with its options.
        name: as in the config.
        reads: for each of its `reads`, the output that the config names.
        measure: of what comes out.
    """

    effect: Effect
    name: str
    reads: tuple[str, ...]
    measure: Measure


def effect_names() -> tuple[str, ...]:
    """Names of all effects: built in, then those that installed packages offer."""
    return (*BUILT_IN, *(name for name in _offered() if name not in BUILT_IN))


@cache
def _offered() -> dict[str, metadata.EntryPoint]:
    return {one.name: one for one in metadata.entry_points(group=_GROUP)}


@cache
def built_in(name: str) -> type[Effect]:
    """The class of a built-in effect."""
    module, _, attribute = BUILT_IN[name].partition(":")
    return getattr(import_module(module, __package__), attribute)


def effect_file(item: Mapping[str, Any]) -> str:
    """The Python file that an entry of `through` takes its effect from; empty if it takes none."""
    file, colon, _ = str(item.get("effect", "")).rpartition(":")
    return file if colon and file.endswith(".py") else ""


def with_units(item: Any) -> Any:
    """An entry of `through` with units for the plain numbers of options that have a unit of their own."""
    name = next((key for key in item if key in BUILT_IN), "") if isinstance(item, Mapping) else ""
    if not name:
        return item
    kind = built_in(name)
    units = {
        key: one.unit
        for key, field in kind.model_fields.items()
        for one in field.metadata
        if isinstance(one, Pure)
    }

    def written(key: str, value: Any) -> Any:
        if isinstance(value, Mapping):
            return {inner: written(inner, one) for inner, one in value.items()}
        plain = isinstance(value, int | float) and not isinstance(value, bool)
        return f"{value!r} {units[key]}" if plain and key in units else value

    return {key: written(kind.main if key == name else key, value) for key, value in item.items()}


def effect_schema() -> dict[str, Any]:
    """JSON Schema of an entry of `through`."""
    own = {"type": "object", "required": ["effect"], "properties": {"effect": {"type": "string"}}}
    own["description"] = "By name, from a file (effects.py:Class) or a module (package.module:Class)."
    forms = []
    for name in BUILT_IN:
        schema = built_in(name).model_json_schema()
        options = schema.get("properties", {})
        options.pop("element", None)
        options = {key: {"description": one.get("description", "")} for key, one in options.items()}
        main = built_in(name).main
        short = {"description": f"{inspect.cleandoc(built_in(name).__doc__ or '').splitlines()[0]}"}
        forms.append(
            {
                "type": "object",
                "required": [name],
                "properties": {name: short, **{key: one for key, one in options.items() if key != main}},
                "additionalProperties": False,
            }
        )
    return {"anyOf": [*forms, own]}


def create_effect(
    item: Any,
    measure: Measure,
    written: Callable[..., str],
    folder: Path,
    element: int | None = None,
    *,
    units: bool = True,
) -> Chosen | list[Problem]:
    """The effect of an entry of `through`.

    Args:
        item: {name: value of the main option, and further options}, {name: {options}}, or
            {effect: name, and options}.
        measure: of the signal that it works on.
        written: where the entry, or an option of it, was written.
        folder: what relative paths start from.
        element: of an array, counted from 0; None for a scalar.
        units: whether `measure` is known; otherwise options in the signal's unit are not checked.
    Returns: the effect, or all that is wrong with it.
    """
    found = _named(item, written, folder)
    if isinstance(found, list):
        return found
    name, kind, given = found
    short = name in item and kind.main in given and kind.main not in item

    def place(key: str = "") -> str:
        return written(*([name if short and key == kind.main else key] if key else []))

    read = given.pop("read", {})
    problems = [*kind.prepare(given, measure, place)]
    fields = kind.model_fields
    allowed = [key for key, one in fields.items() if not one.exclude or key == "unit"]
    for key in [key for key in given if key not in allowed]:
        allowed = [key for key in allowed if key != "unit"] + (["read"] if kind.reads else [])
        what = f"effect {name} has no option {key!r}"
        problems.append(Problem(place(key), what, f"options: {listed(allowed)}", nearest(key, allowed)))
        del given[key]
    for key, value in given.items():
        marks = [mark for mark in fields[key].metadata if isinstance(mark, Pure | OfSignal)]
        if marks and not units and isinstance(marks[0], OfSignal):
            given[key] = 1.0
        elif marks and value is not None:
            wanted = _measure(marks[0], measure)
            number: float | Problem | None = infinite_quantity(value, wanted)
            if number is None:
                difference = isinstance(marks[0], OfSignal) and marks[0].difference
                number = quantity(f"{name}: {key}", wanted, value, place(key), difference)
            if isinstance(number, Problem):
                problems.append(number)
            else:
                given[key] = number
    problems += _reads(name, kind, read, place)
    if problems:
        return problems
    try:
        effect = kind.model_validate(given)
    except ValidationError as error:
        return [_problem(name, kind, one, place) for one in error.errors(include_url=False)]
    if element is not None:
        effect = effect.for_element(element)
    after = effect.outgoing(measure)
    if isinstance(after, str):
        return [Problem(place(), f"effect {name} on a signal in {measure.name or 'no unit'}", after)]
    return Chosen(effect, name, tuple(read[key] for key in kind.reads), after)


def _measure(mark: Pure | OfSignal, measure: Measure) -> Measure:
    if isinstance(mark, Pure):
        return Measure(mark.unit, parse_unit(mark.unit))
    return per_unit(measure, mark.per, parse_unit(mark.per)) if mark.per else measure


def _named(
    item: Any, place: Callable[..., str], folder: Path
) -> tuple[str, type[Effect], dict[str, Any]] | list[Problem]:
    """Name, class and options as given."""
    names = effect_names()
    form = "written as {delay: 1 ms}, or {effect: file.py:Class, and options}"
    if not isinstance(item, Mapping) or not item:
        suggestion = nearest(item, names) if isinstance(item, str) else ""
        return [Problem(place(), f"cannot read the effect {item!r}", form, suggestion)]
    options = dict(item)
    if "effect" in options:
        name = options.pop("effect")
        kind = _class(str(name), place, folder)
        return [kind] if isinstance(kind, Problem) else (str(name), kind, options)
    known = [key for key in options if key in names]
    if len(known) != 1:
        if known:
            what = f"{len(known)} effects in one entry: {listed(known)}"
            return [Problem(place(), what, "one entry for each, in the order in which they work")]
        first = next(iter(options))
        return [
            Problem(
                place(first), f"no effect {first!r}", f"effects: {listed(names)}", nearest(str(first), names)
            )
        ]
    name = known[0]
    value = options.pop(name)
    kind = _class(name, place, folder)
    if isinstance(kind, Problem):
        return [kind]
    if isinstance(value, Mapping):
        twice = [key for key in value if key in options]
        if twice:
            return [Problem(place(twice[0]), f"effect {name}: {twice[0]} is given twice")]
        return name, kind, {**value, **options}
    if value is None:
        return name, kind, options
    if not kind.main:
        what = f"effect {name} has no single value, got {value!r}"
        allowed = f"written as {{{name}: {{{', '.join(f'{key}: ...' for key in kind.model_fields)}}}}}"
        return [Problem(place(name), what, allowed)]
    if kind.main in options:
        return [Problem(place(kind.main), f"effect {name}: {kind.main} is given twice")]
    return name, kind, {kind.main: value, **options}


def _class(name: str, place: Callable[..., str], folder: Path) -> type[Effect] | Problem:
    if name in BUILT_IN:
        return built_in(name)
    try:
        if name in _offered():
            found: Any = _offered()[name].load()
        elif ":" in name:
            where, _, attribute = name.rpartition(":")
            module = _from_file(folder / where) if where.endswith(".py") else import_module(where)
            found = getattr(module, attribute, None)
            if found is None:
                own = [
                    key
                    for key, one in vars(module).items()
                    if inspect.isclass(one) and issubclass(one, Effect) and one is not Effect
                ]
                what = f"{where} has no {attribute!r}"
                return Problem(
                    place("effect"), what, f"effects in it: {listed(own)}", nearest(attribute, own)
                )
        else:
            names = effect_names()
            allowed = f"effects: {listed(names)}; or file.py:Class, or module:Class"
            return Problem(place("effect"), f"no effect {name!r}", allowed, nearest(name, names))
    except Exception as error:  # a user's file may fail in any way
        what = f"cannot load the effect {name!r}: {type(error).__name__}: {error}"
        return Problem(place("effect"), what, f"relative paths start from {folder}" if ".py" in name else "")
    if not (inspect.isclass(found) and issubclass(found, Effect)):
        return Problem(
            place("effect"), f"{name} is no effect", "a class derived from orchestrator.effects.Effect"
        )
    return found


@cache
def _loaded(path: Path, changed: int) -> ModuleType:
    name = f"_effects_of_{path.stem}_{abs(hash((path, changed))):x}"
    spec = util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is no Python file")
    module = util.module_from_spec(spec)
    sys.modules[name] = module  # pydantic looks annotations up there
    spec.loader.exec_module(module)
    return module


def _from_file(path: Path) -> ModuleType:
    path = path.resolve()
    return _loaded(path, path.stat().st_mtime_ns)


def _reads(name: str, kind: type[Effect], read: Any, place: Callable[..., str]) -> list[Problem]:
    if not isinstance(read, Mapping):
        return [
            Problem(
                place("read"), f"effect {name}: cannot read {read!r}", "written as {name: instance.output}"
            )
        ]
    problems = []
    for key in read:
        if key not in kind.reads:
            what = f"effect {name} reads no signal {key!r}"
            problems.append(
                Problem(place("read"), what, f"it reads {listed(kind.reads)}", nearest(key, kind.reads))
            )
    for key in kind.reads:
        if not isinstance(read.get(key), str):
            what = f"effect {name} needs to know which output is its signal {key!r}"
            problems.append(Problem(place("read"), what, f"written as read: {{{key}: instance.output}}"))
    return problems


def _problem(name: str, kind: type[Effect], error: Any, place: Callable[..., str]) -> Problem:
    key = str(error["loc"][0]) if error["loc"] else ""
    at = place(key) if key else place()
    if error["type"] == "missing":
        description = kind.model_fields[key].description or ""
        return Problem(at, f"effect {name}: {key} is missing", f"it has no default. {description}".strip())
    message = error["msg"].removeprefix("Value error, ")
    if error["type"] != "value_error":
        message = f"{message[0].lower()}{message[1:]}, got {error['input']!r}"
    return Problem(at, f"effect {name}: {key + ': ' if key else ''}{message}")
