"""Fields of dataclasses as FMI variables: declaration, registration, and what to say of a wrong value."""

from __future__ import annotations

from dataclasses import Field, field
from typing import Any

from pythonfmu import Boolean, Fmi2Causality, Fmi2Initial, Fmi2Variability, Integer, Real


def quantity(default: Any, unit: str, description: str, kind: str = "local", **limits: str) -> Any:
    """A dataclass field that is an FMI variable: start value, unit, description, causality, min and max."""
    attributes = {"unit": unit, **limits} if unit else limits
    metadata = {"attributes": attributes, "description": description, "kind": kind}
    return field(default=default, metadata=metadata)


def register(
    slave: Any, entry: Field, owner: Any, name: str, causality: Fmi2Causality, variability: Fmi2Variability
) -> None:
    """Register a field of `owner` as a variable of the slave; a tuple of numbers as name[1], name[2], ..."""
    kind = {"int": Integer, "bool": Boolean}.get(entry.type, Real)
    value = getattr(owner, entry.name)
    length = len(value) if isinstance(value, tuple) else 0
    initial = None if causality in (Fmi2Causality.parameter, Fmi2Causality.input) else Fmi2Initial.exact
    for place in range(max(length, 1)):
        label = f"{name}[{place + 1}]" if length else name
        slave.type_attributes[label] = dict(entry.metadata["attributes"])
        slave.register_variable(
            kind(
                label,
                causality=causality,
                variability=variability,
                initial=initial,
                description=entry.metadata["description"],
                getter=_getter(owner, entry.name, place if length else None),
                setter=_setter(owner, entry.name, place if length else None),
            )
        )


def _getter(owner: Any, name: str, place: int | None) -> Any:
    return lambda: getattr(owner, name) if place is None else getattr(owner, name)[place]


def _setter(owner: Any, name: str, place: int | None) -> Any:
    def store(value: Any) -> None:
        if place is not None:
            numbers = getattr(owner, name)
            changed = (*numbers[:place], value, *numbers[place + 1 :])
            value = changed if type(numbers) is tuple else type(numbers)(*changed)
        setattr(owner, name, value)

    return store


def problem(right: bool, sentence: str, wrong: bool = False) -> tuple[bool, str]:
    """Whether something is wrong by now, and the sentence if it is this; the native form asks at run time."""
    if right:
        return wrong, ""
    return True, f"; {sentence}" if wrong else sentence
