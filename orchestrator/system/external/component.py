"""What is reached over UDP, as an instance among the others: its inputs are sent, its outputs received."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...base.errors import FmuError, StepError
from ...base.units import parse_unit
from ...config import ExternalModel
from ...config.base import exact_time
from ...config.external import address
from ...fmi import (
    Array,
    Causality,
    Initial,
    Kind,
    ModelDescription,
    Point,
    StepStatus,
    Value,
    Variability,
    Variable,
)
from .link import Link, LinkError


class ExternalFmu:
    """An external program or rig, as an FMU with one instance.

    At each communication step the values at its beginning are sent; what is received is there at its end.
    With `exchange: lockstep` that is what the peer sent at its step of the same number, so that the link is
    exactly one step of delay each way. With `latest` it is what has come until then.

    Attributes:
        path: None: there is no file.
    """

    path: Path | None = None

    def __init__(self, name: str, model: ExternalModel) -> None:
        self.model = model
        variables = [
            _variable(one, n, Causality.INPUT, unit, 0.0) for n, (one, unit) in enumerate(model.send.items())
        ]
        received = model.received()
        for n, (one, its) in enumerate(received.items(), len(variables)):
            variables.append(_variable(one, n, Causality.OUTPUT, its.unit, its.start_value()))
        self.description = ModelDescription(
            name=f"UDP {model.peer}",
            fmi_version="",
            token="",
            model_identifier=name,
            variables={one.name: one for one in variables},
            feedthrough=dict.fromkeys(received, ()),
            initial_feedthrough=dict.fromkeys(received, ()),
            tool="a program of its own",
        )

    def check(self) -> None:
        """Nothing can be known before the peer answers."""

    def checksum(self) -> str:
        """What the connection is recognised by; its content is another program's."""
        return f"udp:{self.model.peer}"

    def instantiate(self, name: str) -> ExternalInstance:
        """Listen. Raises: FmuError if the address cannot be listened on."""
        return ExternalInstance(name, self)


class ExternalInstance:
    """The running side of a link; see `FmuInstance`."""

    def __init__(self, name: str, fmu: ExternalFmu) -> None:
        self.name, self.description = name, fmu.description
        model = self._model = fmu.model
        self._sent = tuple(model.send)
        self._received = tuple(model.receive)
        self._values: dict[str, float] = {
            one.name: float(one.start or 0.0) for one in self.description.variables.values()
        }
        self._places: list[int] = []
        self._outputs: tuple[str, ...] = ()
        self._u = self._y = np.zeros(0)
        self._timeout = float(exact_time(model.timeout))
        try:
            self._link = Link(address(model.listen), address(model.peer), len(self._received))
        except OSError as error:
            raise FmuError(
                f"external.{name}: cannot use {model.listen} towards {model.peer} ({error})\n"
                "  Is another run listening there? Give another address under listen, and the peer the same."
            ) from error

    def bind(self, inputs: Sequence[str], u: Array, outputs: Sequence[str], y: Array) -> None:
        """See `FmuInstance`."""
        self._places = [self._sent.index(one) for one in inputs]
        self._u, self._outputs, self._y = u, tuple(outputs), y

    def enter_initialisation(
        self, start_time: float, start_values: Mapping[str, Value], stop_time: float | None = None
    ) -> None:
        """See `FmuInstance`."""
        self.set_values(start_values)

    def exit_initialisation(self) -> None:
        """Wait for the peer. Raises: StepError."""
        seconds = float(exact_time(self._model.connect))
        try:
            self._link.connect(seconds)
        except LinkError as error:
            raise StepError(
                str(error),
                instance=self.name,
                time=None,
                status="not connected",
                remedy=f"Start the other side, its peer being {self._model.listen}, or raise `connect`.",
            ) from error

    def set_values(self, values: Mapping[str, Value]) -> None:
        """See `FmuInstance`."""
        self._values.update({name: float(value) for name, value in values.items()})

    def get_values(self, names: Sequence[str]) -> dict[str, Value]:
        """See `FmuInstance`."""
        return {name: self._values[name] for name in names}

    def write_inputs(self) -> None:
        """See `FmuInstance`."""
        for place, value in zip(self._places, self._u.tolist(), strict=True):
            self._values[self._sent[place]] = value

    def do_step(self, point: Point) -> StepStatus:
        """Send the inputs, and take what the peer sent. Raises: StepError."""
        sequence = point.index + 1
        try:
            self._link.send(sequence, point.time, np.array([self._values[one] for one in self._sent]))
            values: Array | None
            if self._model.exchange == "lockstep":
                values = self._link.of_step(sequence, self._timeout)
            else:
                values = self._link.latest(self._timeout)
        except LinkError as error:
            raise StepError(
                str(error), instance=self.name, time=point.time, status="no answer",
                remedy="What was recorded until then is kept. Is the other side running? `timeout` says how "
                "long it may be silent.",
            ) from error  # fmt: skip
        if values is not None:
            self._values.update(zip(self._received, values.tolist(), strict=True))
        return StepStatus.OK

    def read_outputs(self) -> None:
        """See `FmuInstance`."""
        self._y[:] = [self._values[one] for one in self._outputs]

    def terminate(self) -> None:
        """Report the end of the run to the peer."""
        try:
            self._link.end()
        except LinkError as error:
            raise StepError(str(error), instance=self.name, time=None, status="error") from error

    def free(self) -> None:
        """See `FmuInstance`."""
        self._link.close()

    def log_lines(self) -> tuple[str, ...]:
        """See `FmuInstance`; the link's statistics say more."""
        return ()

    def last_successful_time(self) -> float | None:
        """See `FmuInstance`."""
        return None

    def link_statistics(self) -> dict[str, Any]:
        """See `Link.statistics`."""
        return self._link.statistics()


def _variable(name: str, reference: int, causality: Causality, unit: str, start: float) -> Variable:
    output = causality is Causality.OUTPUT
    return Variable(
        name=name,
        reference=reference,
        type="Float64",
        kind=Kind.REAL,
        causality=causality,
        variability=Variability.CONTINUOUS,
        initial=Initial.EXACT if output else None,
        unit=parse_unit(unit) if unit else None,
        unit_name=unit,
        start=start,
    )
