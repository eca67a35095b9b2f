"""What the masters see of a running FMU, whatever is behind it."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .instance import Fmu

from collections.abc import Mapping, Sequence
from enum import IntEnum
from pathlib import Path
from typing import NamedTuple, Protocol

from ..base.arrays import Array
from .description import ModelDescription
from .run_options import DEFAULT_TOLERANCE, Interface
from .variable import Value


class Point(NamedTuple):
    """A communication point.

    Attributes:
        index: its number, from 0.
        time: start time + index * step size, rounded once [s].
        step_size: of the step that begins here [s].
        last: whether the run ends here; no step begins then.
    """

    index: int
    time: float
    step_size: float
    last: bool = False


class StepStatus(IntEnum):
    """How a step went; errors are raised."""

    OK = 0
    WARNING = 1
    DISCARD = 2
    TERMINATED = 6


class FmuInstance(Protocol):
    """A running FMU, with one interface for compiled and Python FMUs and test doubles.

    The order of calls: `bind`, `enter_initialisation`, any of `set_values` and `get_values`,
    `exit_initialisation`, then per step `write_inputs`, `do_step`, `read_outputs`; `terminate` after a run
    that went well; `free` always. Each may raise StepError, after which only `free` may be called.

    `bind` ties numeric ports to memory that the caller owns: a step moves numbers and looks up nothing.
    """

    name: str
    description: ModelDescription

    def bind(self, inputs: Sequence[str], u: Array, outputs: Sequence[str], y: Array) -> None:
        """Tie ports to memory: `write_inputs` sends `u`, `read_outputs` fills `y`.

        Args:
            inputs: names of numeric inputs; u: their values, shape (len(inputs),), contiguous.
            outputs: names of numeric variables to read; y: their values, shape (len(outputs),), contiguous.
        """

    def enter_initialisation(
        self, start_time: float, start_values: Mapping[str, Value], stop_time: float | None = None
    ) -> None:
        """Set start values and enter initialisation mode; times in s."""

    def exit_initialisation(self) -> None:
        """Leave initialisation mode: the instance stands at the first communication point."""

    def set_values(self, values: Mapping[str, Value]) -> None:
        """Set variables by name, in the FMU's units."""

    def get_values(self, names: Sequence[str]) -> dict[str, Value]:
        """Values of variables by name, in the FMU's units."""

    def write_inputs(self) -> None:
        """Send the bound inputs to the FMU."""

    def do_step(self, point: Point) -> StepStatus:
        """Step from `point` by its step size."""

    def read_outputs(self) -> None:
        """Fetch the bound outputs from the FMU."""

    def terminate(self) -> None:
        """End a run that went well."""

    def free(self) -> None:
        """Release the instance; safe to call twice."""

    def log_lines(self) -> tuple[str, ...]:
        """The latest lines that the FMU logged, oldest first."""

    def last_successful_time(self) -> float | None:
        """How far a discarded step came [s]; None where the FMU does not say."""

    # Only where description.capabilities declares them:

    def save_state(self) -> object:
        """The complete state, to be given to `restore_state` and then `free_state`."""

    def restore_state(self, state: object) -> None:
        """Go back to a saved state; it stays valid."""

    def free_state(self, state: object) -> None:
        """Release a saved state."""

    def write_input_derivatives(self, order: int, values: Array) -> None:
        """Send time derivatives of the bound inputs, of an order from 1, shape (inputs,), before `do_step`.

        Only where description.followed names inputs; values of the others are left out.
        """

    def output_derivatives(self, outputs: Sequence[str], inputs: Sequence[str]) -> Array:
        """Partial derivatives at the present instant, shape (outputs, inputs); only where the FMU
        offers directional derivatives.
        """

    def serialise_state(self, state: object) -> bytes:
        """A saved state as bytes."""

    def deserialise_state(self, data: bytes) -> object:
        """A state from bytes, also of another instance of the same FMU."""


class Fmu(Protocol):
    """An FMU from which instances are made.

    Attributes:
        path: the .fmu file; None for one that is made in memory.
    """

    description: ModelDescription
    path: Path | None

    def instantiate(self, name: str) -> FmuInstance:
        """A new instance. Raises: FmuError if it cannot be loaded."""

    def checksum(self) -> str:
        """What identifies the FMU's content, for example "sha256:..."."""


def integration_tolerance(fmu: Fmu) -> float | None:
    """The relative tolerance with which a model-exchange FMU is integrated; None for any other FMU."""
    if fmu.description.interface is not Interface.MODEL_EXCHANGE:
        return None
    asked = getattr(getattr(fmu, "run_options", None), "tolerance", None)
    return asked or fmu.description.tolerance or DEFAULT_TOLERANCE
