"""The running instances of a system: made together, initialised together, freed together."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from itertools import pairwise
from math import ulp
from time import perf_counter_ns
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ..base.errors import OrchestratorError, StepError
from ..fmi import Array, FmuInstance, Point, StepStatus, Value
from ..fmi.working_directory import return_to, working_directory
from ..system.connection import Connection, Port
from ..system.initialisation import settle
from ..system.instance_pool import InstancePool
from ..system.running_connections import RunningConnections
from ..system.signal_vector import Layout, Signals, Wired
from ..system.system import System
from .nonfinite import NonFiniteSources

# Part of a step within which an end of the simulation counts as being at the step's end.
_CLOSE = 1e-9


class Curve(NamedTuple):
    """How all signals run over a step, for what is fed with more than a held value.

    Attributes:
        begin, middle, end: values there, each of shape (layout.size,).
        order: of the polynomial through them, 1 or 2.
        step_size: [s].
    """

    begin: Array
    middle: Array
    end: Array
    order: int
    step_size: float


class Instances:
    """The instances of a system and the memory that their ports are bound to.

    A master loads the signals of an instant, transfers inputs and advances instances in the order it wants,
    and takes the new signals. Between those calls the vector holds what each instance gave last.

    Attributes:
        system, layout: what runs, and where its signals stand.
        running: the instances in the config's order.
        started: how many of them have left initialisation mode.
        terminated: whether all were reported that the run went well.
        texts: outputs of text and binary values as they stand.
        noted_inputs: places of the inputs, see `given`, that masters note of every step that they divide a
            communication step in; None: nobody asks.
        memory: what a master keeps from one step to the next, so that one master serves several runs.
        wires: evaluates connections with effects; None if there are none.
        nonfinite_sources: names who gave a number that is not finite.
        ender: the instance that asked to end the simulation at the end of its latest step, by index; None
            where none did.
    """

    def __init__(self, system: System, layout: Layout) -> None:
        self.system = system
        self.layout = layout
        self.running: list[FmuInstance] = []
        self.started = 0
        self.memory: dict[Any, Any] = {}
        self.ender: int | None = None
        self.noted_inputs: NDArray[np.intp] | None = None
        self._values = np.zeros(layout.size)
        self._finite = np.empty(layout.size, np.bool_)
        self.texts: dict[Port, str | bytes] = {}
        ends = np.cumsum([0, *(len(inputs.names) for inputs in layout.inputs)]).tolist()
        self._all_u = np.zeros(ends[-1])
        self._u = [self._all_u[first:end] for first, end in pairwise(ends)]
        self._transfers = [
            (inputs.source, u, inputs.gain, inputs.offset)
            for inputs, u in zip(layout.inputs, self._u, strict=True)
        ]
        self.nonfinite_sources = NonFiniteSources(system, layout, self.running, self._values, self._u)
        self.terminated = False
        self._complaints: dict[str, list[str]] = {}
        self._elapsed = [0] * len(system.instances)
        self._slopes: dict[int, list[Array]] = {}
        self._bent: dict[int, tuple[Array, Array, Array]] = {}
        self._direct: dict[int, NDArray[np.bool_]] = {}
        self._followed: dict[int, NDArray[np.bool_]] = {}
        # An instance's own step is `every` communication steps, or a communication step is `parts` of it.
        self._every = [one.ratio.numerator for one in system.instances]
        self._parts = [one.ratio.denominator for one in system.instances]
        self._begun: dict[int, Point] = {}
        # Connections with effects; None spares systems without them every further question.
        self.connections = RunningConnections(layout) if layout.wired else None
        self._uncommitted = False

    # What masters use.

    def __len__(self) -> int:
        return len(self.running)

    def load(self, signals: Signals) -> None:
        """Begin from the signals of an instant."""
        self._values[:] = signals.values
        self._uncommitted = True
        if self.texts or signals.texts:
            self.texts = dict(signals.texts)

    def put(self, places: NDArray[np.intp], values: Array, time: float, wired: tuple[Wired, ...]) -> None:
        """Replace signals in the vector: what a master supposes of an instance that has yet to step.

        Args:
            time: the instant that the values belong to [s].
            wired: connections that make a signal of them (`layout.wired_to`).
        """
        self._values[places] = values
        if wired and self.connections is not None:
            self.connections.evaluate_on_trial(wired, time, self._values)

    @property
    def values(self) -> Array:
        """The vector as it stands, shape (layout.size,); a view, not to be written to."""
        return self._values

    def transfer(self, index: int, curve: Curve | None = None) -> None:
        """Feed an instance's inputs from the vector as it stands; the FMU gets them in `advance`.

        With a curve, an input whose course the FMU follows is given value and derivatives at the beginning.
        Any other holds one value over the step: where the input acts on an output at once, that of the end,
        at which outputs are read; elsewhere that of the middle, whose effect is the mean's to second order.
        """
        source, u, gain, offset = self._transfers[index]
        if not u.size:
            return
        if self._bent:
            self._bent.pop(index, None)
        if curve is not None:
            self._feed(index, curve)
        else:
            self._values.take(source, out=u, mode="clip")  # "clip" spares numpy a buffer; indices are valid
        if gain is not None:
            u *= gain
            u += offset

    def _feed(self, index: int, curve: Curve) -> None:
        source, u, gain, _ = self._transfers[index]
        begin, middle, end = (values[source] for values in curve[:3])
        follows = self._follows(index)
        u[:] = np.where(follows, begin, np.where(self._through(index), end, middle))
        if not follows.any():
            return
        bend = 2.0 * (begin + end - 2.0 * middle)
        slopes = [(end - begin - bend) / curve.step_size, 2.0 * bend / curve.step_size**2][: curve.order]
        slopes = [np.where(follows, slope, 0.0) for slope in slopes]
        self._bent[index] = u.copy(), np.where(follows, middle, u), np.where(follows, end, u)
        self._slopes[index] = [slope if gain is None else gain * slope for slope in slopes]

    def _follows(self, index: int) -> NDArray[np.bool_]:
        """Whether the FMU follows the course of each input over a step: what jumps has none."""
        if index not in self._followed:
            followed, inputs = self.running[index].description.followed, self.layout.inputs[index]
            named = np.array([name in followed for name in inputs.names], np.bool_)
            self._followed[index] = named & self.layout.smooth[inputs.source]
        return self._followed[index]

    def _through(self, index: int) -> NDArray[np.bool_]:
        """Which inputs an output of the instance depends on directly."""
        if index not in self._direct:
            one = self.system.instances[index]
            direct = {name for names in one.feedthrough.values() for name in names}
            names = self.layout.inputs[index].names
            self._direct[index] = np.array([name in direct for name in names], np.bool_)
        return self._direct[index]

    def inputs_over_step(self, places: NDArray[np.intp]) -> Array:
        """What inputs were given over the latest step of their instance.

        Args:
            places: of the inputs among all instances' inputs, one instance's after the other's.
        Returns: values at the beginning, in the middle and at the end, shape (3, len(places)), or
            (len(places),) where all were held.
        """
        if not self._bent:
            return self._all_u[places]
        whole = np.tile(self._all_u, (3, 1))
        first = np.cumsum([0, *(u.size for u in self._u)])
        for index, samples in self._bent.items():
            _, u, gain, offset = self._transfers[index]
            for row, sample in zip(whole, samples, strict=True):
                run = sample if gain is None or offset is None else gain * sample + offset
                row[first[index] : first[index] + u.size] = run
        return whole[:, places]

    def begins(self, index: int, point: Point) -> bool:
        """Whether a step of the instance begins at the point; slow ones step once in several steps."""
        return point.index % self._every[index] == 0

    def ends(self, index: int, point: Point) -> bool:
        """Whether a step of the instance ends where the step from the point does: only then it is advanced.

        A slow instance keeps its outputs until then, so that values belong to the instant they are read at.
        """
        every = self._every[index]
        if every == 1:
            return True
        if point.index % every == 0:
            self._begun[index] = point
        return (point.index + 1) % every == 0

    def hold(self, index: int, point: Point) -> None:
        """An instance's step does not end where that from the point does: its outputs stay until there."""
        if self.connections is not None:
            self.connections.update_after(index, point.time + point.step_size, self._values)

    def advance(self, index: int, point: Point) -> StepStatus:
        """Set an instance's inputs, step it and read its outputs into the vector.

        Raises: StepError if the FMU fails.
        """
        one = self.running[index]
        begin = perf_counter_ns()
        try:
            one.write_inputs()
            if self.layout.text_inputs[index]:
                one.set_values({name: self.texts[port] for name, port in self.layout.text_inputs[index]})
            slopes = self._slopes.pop(index, None)
            for order, slope in enumerate(slopes or (), 1):
                one.write_input_derivatives(order, slope)
            status = self._do_step(index, point, slopes)
            if status is StepStatus.TERMINATED and self.is_complete(index, point):
                self.ender, status = index, StepStatus.OK
            if status <= StepStatus.WARNING:
                one.read_outputs()
                if self.layout.text_outputs[index]:
                    self._read_texts(index)
                if self.connections is not None:
                    self.connections.update_after(index, point.time + point.step_size, self._values)
        except StepError as error:
            self.nonfinite_sources.blame_inputs(index, point, error)
            raise
        self._elapsed[index] += perf_counter_ns() - begin
        return status

    def is_complete(self, index: int, point: Point) -> bool:
        """Whether an instance that asks to end the simulation finished the step from `point` before."""
        reached, end = self.running[index].last_successful_time(), point.time + point.step_size
        return reached is not None and reached >= end - max(_CLOSE * point.step_size, 8.0 * ulp(end))

    def _do_step(self, index: int, point: Point, slopes: Sequence[Array] | None) -> StepStatus:
        one, count, every = self.running[index], self._parts[index], self._every[index]
        if every > 1:
            begun = self._begun[index]
            return one.do_step(Point(begun.index // every, begun.time, every * point.step_size))
        if count == 1:
            return one.do_step(point)
        size = point.step_size / count
        # FMI 2's derivatives hold for one step only; what follows a curve by FMI 3's updates keeps it.
        bent = slopes is not None and one.description.capabilities.interpolate_inputs
        begin = self._u[index].copy()
        for part in range(count):
            passed = point.step_size * (part / count)
            if part and slopes is not None and bent:
                self._bend_on(index, begin, slopes, passed)
            status = one.do_step(Point(point.index * count + part, point.time + passed, size))
            if status > StepStatus.WARNING:
                break
        return status

    def _bend_on(self, index: int, begin: Array, slopes: Sequence[Array], passed: float) -> None:
        """Send an instance's inputs, and their derivatives, as they are within the step.

        Args:
            begin, slopes: values and derivatives at its begin, each of shape (inputs,).
            passed: since then [s].
        """
        one, u, follows, first = self.running[index], self._u[index], self._follows(index), slopes[0]
        run = begin + passed * first
        if len(slopes) > 1:
            run += 0.5 * passed * passed * slopes[1]
            first = first + passed * slopes[1]
        u[:] = np.where(follows, run, begin)
        one.write_inputs()
        for order, slope in enumerate((first, *slopes[1:]), 1):
            one.write_input_derivatives(order, slope)

    @contextmanager
    def checkpoint(self, indices: Iterable[int]) -> Iterator[Callable[[], None]]:
        """Keep the states of instances; the function that is given brings them back, as often as called.

        With them goes what all effects remember.
        """
        remembered = self.connections.snapshot() if self.connections is not None else None
        saved = [(self.running[index], self.running[index].save_state()) for index in indices]

        def back() -> None:
            self.ender = None
            for one, state in saved:
                one.restore_state(state)
            if remembered is not None:
                remembered()

        broken = None
        try:
            yield back
        except StepError as error:
            broken = error.instance if error.status in ("error", "fatal") else None
            raise
        finally:
            for one, state in reversed(saved):
                if one.name != broken:  # after an error an FMU may only be freed
                    one.free_state(state)

    def signals(self, time: float | None) -> Signals:
        """The signals as they stand, as a new vector. They are accepted: effects remember them.

        Args:
            time: the instant they belong to [s], for messages; None before the first.
        Raises: StepError naming the first variable that is not a finite number.
        """
        if self.connections is not None and self._uncommitted and time is not None:
            self._uncommitted = False
            self.connections.commit(time, self._values)
        # A search in bytes, since a reduction of the Boolean array would cost four times as much per step.
        np.isfinite(self._values, self._finite)
        if 0 in self._finite.tobytes():
            self.nonfinite_sources.report_non_finite(time)
        return Signals(self._values.copy(), dict(self.texts))

    # What the native loop uses.

    def courses(self, index: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Of each input of an instance, whether it follows a curve, and whether an output depends on it at
        once: see `transfer`.
        """
        return self._follows(index), self._through(index)

    @property
    def native_memory(self) -> tuple[Array, Array]:
        """The signals, shape (layout.size,), and all instances' inputs one after the other: as bound."""
        return self._values, self._all_u

    def add_elapsed(self, nanoseconds: Sequence[int]) -> None:
        """Count time that was spent in each instance's steps."""
        self._elapsed = [before + more for before, more in zip(self._elapsed, nanoseconds, strict=True)]

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
            stop = stop_time
            if stop is not None and instance.ratio != 1:  # the ends of own steps are rounded once more
                stop += 2.0 * ulp(stop)
            one.enter_initialisation(start_time, instance.start, stop)
        unsolved = settle(
            self.system, self.running, start_time, self.nonfinite_sources.check_initial, self._made
        )
        for error in unsolved:
            what = f"[{error.status}] {error.what}; it begins with start values"
            self.complain(error.instance, " ".join(what.split()))
        for one in self.running:
            one.exit_initialisation()
            self.started += 1
        for index, one in enumerate(self.running):
            one.read_outputs()
            self._read_texts(index)
        self._uncommitted = True
        return self.signals(start_time)

    def _made(self, connection: Connection, values: Mapping[Port, Value], time: float) -> float:
        """The signal of a connection with effects, of values of its sources at the start."""
        assert self.connections is not None
        for port in connection.sources:
            self._values[self.layout.index[port]] = values[port]
        chain = self.layout.chain(connection)
        self.connections.evaluate_on_trial(chain, time, self._values)
        for one in chain:
            if not np.isfinite(self._values[one.place]):
                self.nonfinite_sources.raise_made(one, None)
        return float(self._values[chain[-1].place])

    def terminate(self) -> None:
        """End a successful run; a failure of an FMU here changes no result and is reported as a warning."""
        self.terminated = True
        for one in self.running:
            try:
                one.terminate()
            except StepError as error:
                self.complain(one.name, f"[{error.status}] {error.what}")

    def complain(self, instance: str, line: str) -> None:
        """Add a line to what `warnings` gives of an instance."""
        self._complaints.setdefault(instance, []).append(line)

    def warnings(self) -> dict[str, list[str]]:
        """What each instance logged beyond mere information; instances that did not are left out."""
        logged = {
            one.name: [line for line in one.log_lines() if not line.startswith("[ok]")]
            for one in self.running
        }
        for name, lines in self._complaints.items():
            logged[name] += lines
        return {name: lines for name, lines in logged.items() if lines}

    def elapsed(self) -> dict[str, float]:
        """Wall time spent in each instance's steps so far [s]."""
        return {
            one.name: elapsed * 1e-9
            for one, elapsed in zip(self.system.instances, self._elapsed, strict=True)
        }

    def link_statistics(self) -> dict[str, Any]:
        """What links to external programs counted, by instance."""
        links = {one.name: getattr(one, "link_statistics", None) for one in self.running}
        return {name: read() for name, read in links.items() if read is not None}

    def _read_texts(self, index: int) -> None:
        names = self.layout.text_outputs[index]
        if names:
            values = self.running[index].get_values(names)
            name = self.system.instances[index].name
            self.texts.update((Port(name, key), cast(str | bytes, value)) for key, value in values.items())


@contextmanager
def instantiate(
    system: System, layout: Layout | None = None, pool: InstancePool | None = None
) -> Iterator[Instances]:
    """Make all instances of a system, and free them whatever happens.

    Args:
        pool: from which they are taken and to which they are given back instead.
    Raises: FmuError if an FMU cannot be loaded.
    """
    instances = Instances(system, layout or Layout.of(system))
    directory = working_directory()
    failed: str | None = None
    finished = False
    try:
        for instance in system.instances:
            made = instance.fmu.instantiate(instance.name) if pool is None else pool.take(instance)
            instances.running.append(made)
            return_to(directory)
        yield instances
        finished = True
        if not instances.terminated:
            instances.terminate()
    except StepError as error:
        failed = error.instance
        raise
    finally:
        for index, one in reversed(list(enumerate(instances.running))):
            if not finished and one.name != failed and index < instances.started:
                with suppress(OrchestratorError):  # the first error is reported
                    one.terminate()
            with suppress(OrchestratorError):
                if pool is None:
                    one.free()
                else:
                    pool.give_back(system.instances[index], one)
        return_to(directory)
