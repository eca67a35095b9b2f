"""The running instances of a system: made together, initialised together, freed together."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from time import perf_counter_ns

import numpy as np

from .errors import OrchestratorError, StepError
from .fmi import FmuInstance, Point, StepStatus, Value
from .signals import Layout, Signals
from .system import Port, System

__all__ = ["Instances", "instantiate"]


class Instances:
    """The instances of a system and the memory that their ports are bound to.

    A master loads the signals of an instant, transfers inputs and advances instances in the order it wants,
    and takes the new signals. Between those calls the vector holds what each instance gave last.

    Attributes:
        system, layout: what runs, and where its signals stand.
        running: the instances in the config's order.
        started: how many of them have left initialisation mode.
    """

    def __init__(self, system: System, layout: Layout) -> None:
        self.system = system
        self.layout = layout
        self.running: list[FmuInstance] = []
        self.started = 0
        self._values = np.zeros(layout.size)
        self._finite = np.empty(layout.size, np.bool_)
        self._texts: dict[Port, str] = {}
        self._u = [np.zeros(len(inputs.names)) for inputs in layout.inputs]
        self._transfers = [
            (inputs.source, u, inputs.gain, inputs.offset)
            for inputs, u in zip(layout.inputs, self._u, strict=True)
        ]
        self._elapsed = [0] * len(system.instances)

    # What masters use.

    def __len__(self) -> int:
        return len(self.running)

    def load(self, signals: Signals) -> None:
        """Begin from the signals of an instant."""
        self._values[:] = signals.values
        if self._texts or signals.texts:
            self._texts = dict(signals.texts)

    def transfer(self, index: int) -> None:
        """Feed an instance's inputs from the vector as it stands; the FMU gets them in `advance`."""
        source, u, gain, offset = self._transfers[index]
        if not u.size:
            return
        self._values.take(source, out=u, mode="clip")  # "clip" spares numpy a buffer; indices are valid
        if gain is not None:
            u *= gain
            u += offset

    def advance(self, index: int, point: Point) -> StepStatus:
        """Set an instance's inputs, step it and read its outputs into the vector.

        Raises: StepError if the FMU fails.
        """
        one = self.running[index]
        begin = perf_counter_ns()
        try:
            one.write_inputs()
            if self.layout.text_inputs[index]:
                one.set_values({name: self._texts[port] for name, port in self.layout.text_inputs[index]})
            status = one.do_step(point)
            if status <= StepStatus.WARNING:
                one.read_outputs()
                if self.layout.text_outputs[index]:
                    self._read_texts(index)
        except StepError as error:
            self._blame_inputs(index, point, error)
            raise
        self._elapsed[index] += perf_counter_ns() - begin
        return status

    def signals(self, time: float | None) -> Signals:
        """The signals as they stand, as a new vector.

        Args:
            time: the instant they belong to [s], for messages; None before the first.
        Raises: StepError naming the first variable that is not a finite number.
        """
        # A search in bytes, since a reduction of the Boolean array would cost four times as much per step.
        np.isfinite(self._values, self._finite)
        if 0 in self._finite.tobytes():
            self._report_non_finite(time)
        return Signals(self._values.copy(), dict(self._texts) if self._texts else {})

    # Life.

    def initialise(self, start_time: float, stop_time: float | None) -> Signals:
        """Set start values, pass initial outputs on in the order of feedthrough, leave initialisation mode.

        Returns: the signals at the start time.
        Raises: StepError.
        """
        for index, (instance, one) in enumerate(zip(self.system.instances, self.running, strict=True)):
            one.bind(
                self.layout.inputs[index].names,
                self._u[index],
                self.layout.outputs[index],
                self._values[self.layout.spans[index]],
            )
            one.enter_initialisation(start_time, instance.start, stop_time)
        for connections in self.system.initial_levels:
            targets: dict[int, dict[str, Value]] = {}
            sources: dict[int, dict[str, Value]] = {}
            for connection in connections:
                sources.setdefault(self.system.position[connection.source.instance], {})[
                    connection.source.variable
                ] = 0.0
            values = {index: self.running[index].get_values(list(names)) for index, names in sources.items()}
            for connection in connections:
                value = values[self.system.position[connection.source.instance]][connection.source.variable]
                if isinstance(value, float):
                    self._check_initial(connection.source, value)
                    if connection.gain != 1.0 or connection.offset != 0.0:
                        value = connection.gain * value + connection.offset
                position = self.system.position[connection.target.instance]
                targets.setdefault(position, {})[connection.target.variable] = value
            for position, inputs in targets.items():
                self.running[position].set_values(inputs)
        for one in self.running:
            one.exit_initialisation()
            self.started += 1
        for index, one in enumerate(self.running):
            one.read_outputs()
            self._read_texts(index)
        return self.signals(start_time)

    def terminate(self) -> None:
        """End a run that went well."""
        for one in self.running:
            one.terminate()

    def warnings(self) -> dict[str, list[str]]:
        """What each instance logged beyond mere information; instances that did not are left out."""
        told = {
            one.name: [line for line in one.log_lines() if not line.startswith("[ok]")]
            for one in self.running
        }
        return {name: lines for name, lines in told.items() if lines}

    def elapsed(self) -> dict[str, float]:
        """Wall time spent in each instance's steps so far [s]."""
        return {
            one.name: elapsed * 1e-9
            for one, elapsed in zip(self.system.instances, self._elapsed, strict=True)
        }

    # Failures.

    def _read_texts(self, index: int) -> None:
        names = self.layout.text_outputs[index]
        if names:
            values = self.running[index].get_values(names)
            name = self.system.instances[index].name
            self._texts.update({Port(name, key): str(value) for key, value in values.items()})

    def _check_initial(self, port: Port, value: float) -> None:
        if not np.isfinite(value):
            self._raise_non_finite(port, value, None)

    def _blame_inputs(self, index: int, point: Point, error: StepError) -> None:
        """An FMU that fails on a NaN it was given is not the culprit: name the one that gave it."""
        if np.isfinite(self._u[index]).all():
            return
        position = int(np.flatnonzero(~np.isfinite(self._u[index]))[0])
        source = int(self.layout.inputs[index].source[position])
        port = next(port for port, place in self.layout.index.items() if place == source)
        if not np.isfinite(self._values[source]):
            time = point.time + point.step_size
            self._raise_non_finite(port, float(self._values[source]), time, error)

    def _report_non_finite(self, time: float | None) -> None:
        for index in self.system.order:
            span = self.layout.spans[index]
            for position in np.flatnonzero(~np.isfinite(self._values[span])):
                port = Port(self.system.instances[index].name, self.layout.outputs[index][position])
                self._raise_non_finite(port, float(self._values[span][position]), time)

    def _raise_non_finite(
        self, port: Port, value: float, time: float | None, cause: Exception | None = None
    ) -> None:
        one = self.running[self.system.position[port.instance]]
        text = str(self.system.variable(port)).removeprefix(port.variable)
        raise StepError(
            f"{port.variable}{text} is {value!r}",
            instance=port.instance,
            time=time,
            status="not finite",
            log=one.log_lines(),
            remedy="Check the values that it is given, or take a smaller step size.",
        ) from cause


@contextmanager
def instantiate(system: System, layout: Layout | None = None) -> Iterator[Instances]:
    """Make all instances of a system, and free them whatever happens.

    Raises: FmuError if an FMU cannot be loaded.
    """
    instances = Instances(system, layout or Layout.of(system))
    failed: str | None = None
    finished = False
    try:
        for instance in system.instances:
            instances.running.append(instance.fmu.instantiate(instance.name))
        yield instances
        finished = True
        instances.terminate()
    except StepError as error:
        failed = error.instance
        raise
    finally:
        for index, one in reversed(list(enumerate(instances.running))):
            if not finished and one.name != failed and index < instances.started:
                with suppress(OrchestratorError):  # the first error is the one to tell
                    one.terminate()
            with suppress(OrchestratorError):
                one.free()
