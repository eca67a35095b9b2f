"""The parts of a config that concern the world outside: the clock, and programs or rigs reached over UDP."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, StringConstraints, field_validator, model_validator

from ..base.units import UnitError, parse_unit, quantity_in
from .base import Model, Time, checked_time, exact_time

_Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z_][A-Za-z0-9_.\[\],]*$")]


class RealtimeModel(Model):
    """How communication steps are paced by the clock."""

    speed: float = Field(1.0, gt=0, allow_inf_nan=False, description="Simulated seconds per second.")
    on_miss: Literal["catch-up", "shift", "stop"] = Field(
        "catch-up",
        description="What to do where a step ends after its deadline: take the next ones at once until the "
        "clock is caught up with, move all later deadlines, or end the run.",
    )
    misses: int = Field(
        1, ge=1, strict=True, description="With on_miss: stop, how many deadlines in a row are too many."
    )
    spin: Time = Field(
        "0.2 ms",
        description="How long before a deadline the loop stops sleeping and watches the clock: longer is "
        "more punctual and costs a core.",
    )
    priority: int | None = Field(
        None,
        ge=1,
        le=99,
        strict=True,
        description="Priority under the real-time scheduler (Linux, SCHED_FIFO); where the system refuses "
        "it, the run goes on without and the summary says so.",
    )

    @field_validator("spin", mode="before")
    @classmethod
    def _is_time(cls, value: Any) -> str:
        text = checked_time(value)
        if exact_time(text) < 0:
            raise ValueError(f"{value!r} is negative")
        return text


class ReceivedModel(Model):
    """A value that is received."""

    unit: str = Field(description="Its unit on the wire; empty for a number without one.")
    start: int | float | str = Field(
        0, description="What it is before the first one is received, with its unit."
    )

    @field_validator("unit")
    @classmethod
    def _is_unit(cls, value: str) -> str:
        return _unit(value)

    @model_validator(mode="after")
    def _has_start(self) -> ReceivedModel:
        self.start_value()
        return self

    def start_value(self) -> float:
        """The start value in `unit`. Raises: ValueError."""
        if self.start == 0 and not isinstance(self.start, str):
            return 0.0
        try:
            return quantity_in(str(self.start), parse_unit(self.unit))
        except UnitError as error:
            raise ValueError(f"start: {error}") from None


class ExternalModel(Model):
    """A program or a rig that takes and gives values over UDP, a datagram each way per communication step."""

    listen: str = Field(description="Where this side receives.", examples=["127.0.0.1:47010"])
    peer: str = Field(description="Where the other side receives.", examples=["127.0.0.1:47011"])
    send: dict[_Name, str] = Field(
        default_factory=dict, description="Inputs, in the order of the datagram, and their units on the wire."
    )
    receive: dict[_Name, str | ReceivedModel] = Field(
        default_factory=dict,
        description="Outputs, in the order of the datagram: their units on the wire, or with start values.",
        examples=[{"force": "N", "position": {"unit": "mm", "start": "0 mm"}}],
    )
    exchange: Literal["latest", "lockstep"] = Field(
        description="latest: take what has come, never wait, for runs that are paced; lockstep: both sides "
        "wait for each other at every step, for runs without a clock."
    )
    timeout: Time = Field("1 s", description="How long the other side may be silent before the run ends.")
    connect: Time = Field("30 s", description="How long to wait for it at the start.")

    @field_validator("listen", "peer")
    @classmethod
    def _is_address(cls, value: str) -> str:
        address(value)
        return value

    @field_validator("send")
    @classmethod
    def _are_units(cls, value: dict[str, str]) -> dict[str, str]:
        return {name: _unit(unit) for name, unit in value.items()}

    @field_validator("timeout", "connect", mode="before")
    @classmethod
    def _is_time(cls, value: Any) -> str:
        text = checked_time(value)
        if exact_time(text) <= 0:
            raise ValueError(f"{value!r} is not positive")
        return text

    @model_validator(mode="after")
    def _is_consistent(self) -> ExternalModel:
        for name, unit in self.receive.items():
            if isinstance(unit, str):
                try:
                    _unit(unit)
                except ValueError as error:
                    raise ValueError(f"receive.{name}: {error}") from None
        both = [name for name in self.send if name in self.receive]
        if both:
            raise ValueError(f"{both[0]!r} is sent and received; each direction needs a name of its own")
        if not self.send and not self.receive:
            raise ValueError("nothing is sent and nothing received; name values under send or receive")
        if self.listen == self.peer:
            raise ValueError(f"listen and peer are both {self.peer}; each side needs an address of its own")
        return self

    def received(self) -> dict[str, ReceivedModel]:
        """What is received, in the order of the datagram."""
        return {
            name: ReceivedModel(unit=one) if isinstance(one, str) else one
            for name, one in self.receive.items()
        }


def address(text: str) -> tuple[str, int]:
    """Host and port of "host:port" or "[IPv6]:port". Raises: ValueError."""
    host, colon, port = text.strip().rpartition(":")
    if host.startswith("[") and host.endswith("]"):
        host = host[1:-1]
    elif ":" in host:
        colon = ""  # an IPv6 address without brackets
    if not colon or not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise ValueError(f"{text!r} is no address; written as 127.0.0.1:47010, ports from 1 to 65535")
    return host, int(port)


def _unit(text: str) -> str:
    if text:
        try:
            parse_unit(text)
        except UnitError as error:
            raise ValueError(str(error)) from None
    return text
