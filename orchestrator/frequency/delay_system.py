"""Closed linear systems with delays: what their loops do when they are cut, and how much they bear."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from ..base import graph
from ..base.arrays import Array, Complex
from ..base.errors import ConfigError, Problem, listed, nearest
from ..translate.linear_model import as_state_space
from .characteristic_roots import CharacteristicRoots
from .delay_equation import SMALL, Link, in_parts
from .margins import FAR, Crossover, DelayMargin, Margins, borne_delay, gain_crossovers
from .modes import Modes
from .refine import minima, zeros

if TYPE_CHECKING:
    import control

# Stands in the names of blocks and links that low-pass filters of connections become.
FILTER = " filter"

# |L| below this limits no gain.
_NO_GAIN = 1e-9
# What is asked for at so many frequencies is asked for again.
_GRID = 1000
# Deepest dips on the grid that are followed down: a sharp one may be deeper than the deepest there.
_DIPS = 4


class DelaySystem(CharacteristicRoots):
    """A closed linear system with delays and its loops."""

    @staticmethod
    def loop(system: Any, delay: float = 0.0, name: str = "loop") -> DelaySystem:
        """Negative feedback around a system of python-control or scipy behind a delay: 1 + L(s) exp(-delay
        s).

        Args:
            system: continuous, with as many outputs as inputs; each output feeds the input of its number.
            delay: [s].
            name: of the connection; of several "name[1]" and so on.
        Raises: ConfigError if the system is discrete or has other ports, or the delay is negative.
        """
        space = as_state_space(system, name)
        problems = []
        if space.isdtime(strict=True) or space.ninputs != space.noutputs:
            what = f"it has {space.ninputs} inputs, {space.noutputs} outputs and dt = {space.dt}"
            problems.append(Problem(name, what, "continuous time, as many outputs as inputs"))
        if not (np.isfinite(delay) and delay >= 0.0):
            problems.append(Problem(name, f"delay is {delay!r} s", "allowed: finite and not negative"))
        if problems:
            raise ConfigError(problems)
        count = space.ninputs
        names = [name] if count == 1 else [f"{name}[{index + 1}]" for index in range(count)]
        a, b, c, d = (np.asarray(one, np.float64) for one in (space.A, space.B, space.C, space.D))
        return DelaySystem(
            a, b, c, d,
            tuple(f"{name}.x{index + 1}" for index in range(space.nstates)),
            tuple(f"{name}.u{index + 1}" for index in range(count)),
            tuple(f"{name}.y{index + 1}" for index in range(count)),
            tuple(Link(one, index, index, -1.0, float(delay)) for index, one in enumerate(names)),
        )  # fmt: skip

    def connection(self, name: str) -> str:
        """A connection as links name it, by that name, as "a.y -> b.u" or by its target.

        Raises: ConfigError if there is none.
        """
        return self._named([name])[0]

    def _named(self, names: Sequence[str]) -> list[str]:
        """`connection` of several names. Raises: ConfigError with all that there are not."""
        known = list(dict.fromkeys(one.connection for one in self.links if FILTER not in one.connection))
        ends = {_ends(one): one for one in known} | {one.rpartition(" -> ")[2]: one for one in known}
        allowed = f"there are {listed(known)}"
        problems = [
            Problem("connection", f"no connection {name!r}", allowed, nearest(name, [*known, *ends]))
            for name in names
            if name not in known and name not in ends
        ]
        if problems:
            raise ConfigError(problems)
        return [name if name in known else ends[name] for name in names]

    def later(self, connection: str, delay: float) -> DelaySystem:
        """The same system with a connection that is later by a delay [s].

        Args: connection: as a link names it, or its target. Raises: ConfigError if there is none.
        """
        connection = self.connection(connection)
        links = tuple(
            one._replace(delay=one.delay + delay) if one.connection == connection else one
            for one in self.links
        )
        return replace(self, links=links)

    def scaled(self, connection: str, factor: float) -> DelaySystem:
        """The same system with the gain of a connection times a factor.

        Args: connection: as for `later`. Raises: ConfigError if there is none.
        """
        connection = self.connection(connection)
        links = tuple(
            one._replace(gain=one.gain * factor) if one.connection == connection else one
            for one in self.links
        )
        return replace(self, links=links)

    def loops(self) -> tuple[str, ...]:
        """Connections within feedback loops, in their order."""
        owners = {_owner(one) for one in (*self.inputs, *self.outputs)}
        place = {name: index for index, name in enumerate(sorted(owners))}
        after: list[set[int]] = [set() for _ in place]
        ends = [
            (one.connection, place[_owner(self.outputs[one.source])], place[_owner(self.inputs[one.target])])
            for one in self.links
        ]
        for _, source, target in ends:
            after[source].add(target)
        group: dict[int, int] = {}
        for number, members in enumerate(graph.strong_components([sorted(one) for one in after])):
            group |= dict.fromkeys(members, number)
        # What leads into a connection's filter is a part of that connection.
        named = (
            name for name, source, target in ends if group[source] == group[target] and FILTER not in name
        )
        return tuple(dict.fromkeys(named))

    def open_loop(self, connection: str, omega: ArrayLike) -> Complex:
        """L(j omega) with one connection cut, of negative feedback: the closed loop is 1 + L.

        Args:
            connection: as a link names it.
            omega: shape (k,) [rad/s].
        """
        connection = self.connection(connection)
        return self.response(connection, 1j * np.atleast_1d(np.asarray(omega, np.float64)))

    def open_loops(self, connections: Sequence[str], omega: ArrayLike) -> Complex:
        """L(j omega) with several connections cut at once, shape (k, connections, connections).

        Args:
            connections: as links name them; a row is what comes back at one, a column what is put in at one.
            omega: shape (k,) [rad/s].
        """
        return self._opened(self._named(connections), 1j * np.atleast_1d(np.asarray(omega, np.float64)))

    def response(self, connection: str, s: ArrayLike) -> Complex:
        """L(s) of `open_loop` at any s, of the shape of s [rad/s]."""
        s = np.asarray(s, np.complex128)
        return self._opened([connection], s.ravel())[:, 0, 0].reshape(s.shape)

    def driven(self, given: Mapping[str, ArrayLike], target: str, s: ArrayLike) -> Complex:
        """What arrives at an input where some outputs are given, whatever their instances do.

        Args:
            given: Laplace transforms of outputs at s, by name; 0 cuts what leads on from an output.
            target: the input.
            s: shape (k,) [rad/s].
        """
        s = np.atleast_1d(np.asarray(s, np.complex128))
        n, cut = len(self.states), {self.outputs.index(name): np.asarray(one) for name, one in given.items()}
        rest = self._gains([one for one in self.links if one.source not in cut])
        wanted = np.zeros((len(s), n + len(self.inputs), 1), np.complex128)
        for one in self.links:
            if one.source in cut:
                wanted[:, n + one.target, 0] += one.gain * np.exp(-s * one.delay) * cut[one.source]
        return np.linalg.solve(self._matrix(s, rest), wanted)[:, n + self.inputs.index(target), 0]

    @cached_property
    def _kept(self) -> dict[tuple[str, ...], tuple[Complex, Complex]]:
        """The grid that connections were last opened on, and what came back."""
        return {}

    def _opened(self, connections: Sequence[str], s: Complex) -> Complex:
        name = tuple(connections)
        if len(s) < _GRID:
            return self._open(connections, s)
        if name not in self._kept or not np.array_equal(self._kept[name][0], s):
            self._kept[name] = s, self._open(connections, s)
        return self._kept[name][1]

    def _open_all(self, s: Complex) -> None:
        """Open each connection on its own on a grid, if none of them is known there yet."""
        if len(self.states) <= SMALL and not any(np.array_equal(at, s) for at, _ in self._kept.values()):
            self._kept.update({(one,): (s, back) for one, back in self._each(s).items()})

    def _each(self, s: Complex) -> dict[str, Complex]:
        """`_opened` of every connection with one target on its own, by one factorisation of the closed loop.

        Where 1 is added to an input, it becomes S = 1/(1 + L), and -L S comes back.
        """
        owned: dict[str, list[Link]] = {}
        for link in self.links:
            owned.setdefault(link.connection, []).append(link)
        owned = {name: links for name, links in owned.items() if len({one.target for one in links}) == 1}
        targets = [links[0].target for links in owned.values()]
        drive = np.zeros((len(self.inputs), len(targets)))
        drive[targets, range(len(targets))] = 1.0
        found = np.zeros((len(owned), len(s), 1, 1), np.complex128)
        begin = 0
        for part in in_parts(s):
            try:
                u, y = self._driven(part, drive)
            except np.linalg.LinAlgError:  # a root lies on the axis
                return {}
            for row, links in enumerate(owned.values()):
                back = sum(one.gain * np.exp(-part * one.delay) * y[:, one.source, row] for one in links)
                with np.errstate(divide="ignore", invalid="ignore"):  # L is infinite, as of an integrator
                    found[row, begin : begin + len(part), 0, 0] = -back / u[:, links[0].target, row]
            begin += len(part)
        return {name: one for name, one in zip(owned, found, strict=True) if np.isfinite(one).all()}

    def _open(self, connections: Sequence[str], s: Complex) -> Complex:
        own = [[one for one in self.links if one.connection == name] for name in connections]
        rest = self._gains([one for one in self.links if one.connection not in connections])
        # Further places that a connection feeds, as the delayed path into an FMU, carry the same signal.
        drive = np.zeros((len(self.inputs), len(own)))
        for column, links in enumerate(own):
            drive[[one.target for one in links], column] = 1.0
        if len(self.states) > SMALL and not self._near_poles(s).any():
            targets, sources = self._reduced[4:]
            response = self._instances(s)
            k = np.einsum("sk,kmp->smp", np.exp(-s[:, None] * self._delays), rest[:, targets][:, :, sources])
            wanted = np.broadcast_to(drive[targets], (len(s), len(targets), len(own)))
            y = response @ np.linalg.solve(np.eye(len(targets)) - k @ response, wanted)
            rows = {source: row for row, source in enumerate(sources)}
        else:
            y = np.concatenate([self._driven(one, drive, rest)[1] for one in in_parts(s)])
            rows = {source: source for source in range(len(self.outputs))}
        back = np.zeros((len(s), len(own), len(own)), np.complex128)
        for row, links in enumerate(own):
            first = min(one.target for one in links)
            for one in links:
                if one.target == first:
                    back[:, row] += (one.gain * np.exp(-s * one.delay))[:, None] * y[:, rows[one.source]]
        return -back

    def to_control(self, connection: str, order: int = 6) -> control.StateSpace:
        """L(s) of `open_loop` as a state space of python-control, delays by Pade's approximation.

        It is near the exact one where |s| times the longest delay is below `order`; `to_response` is exact.

        Args:
            connection: as a link names it.
            order: of the approximation of each delay.
        """
        import control

        n, m = len(self.states), len(self.inputs)
        parts = []
        at_once = np.zeros((m, len(self.outputs)))
        for one in self.links:
            if one.delay > 0.0:
                late = control.tf2ss(*control.pade(one.delay, order))
                blocks = [np.atleast_2d(np.asarray(x, float)) for x in (late.A, late.B, late.C, late.D)]
            else:
                blocks = [np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1))]
            parts.append(blocks)
        lines = scipy.linalg.block_diag(np.zeros((0, 0)), *(one[0] for one in parts))
        size = n + len(lines)
        into = np.zeros((size, len(self.outputs)))
        ends, back, back_at_once = np.zeros((m, size)), np.zeros((1, size)), np.zeros((1, len(self.outputs)))
        drive = np.zeros((m, 1))
        own = [one for one in self.links if one.connection == connection]
        first = min(one.target for one in own)
        low = n
        for one, (a, b, c, d) in zip(self.links, parts, strict=True):
            high = low + len(a)
            into[low:high, one.source] += b[:, 0]
            if one.connection != connection:
                ends[one.target, low:high] += one.gain * c[0]
                at_once[one.target, one.source] += one.gain * d[0, 0]
                low = high
                continue
            drive[one.target] = 1.0
            if one.target == first:
                back[0, low:high] += one.gain * c[0]
                back_at_once[0, one.source] += one.gain * d[0, 0]
            low = high
        c = np.hstack([self.c, np.zeros((len(self.outputs), size - n))])
        solved = np.linalg.inv(np.eye(m) - at_once @ self.d)
        u_of_x, u_of_v = solved @ (at_once @ c + ends), solved @ drive
        y_of_x, y_of_v = c + self.d @ u_of_x, self.d @ u_of_v
        a = scipy.linalg.block_diag(self.a, lines) + into @ y_of_x
        b = into @ y_of_v
        a[:n] += self.b @ u_of_x
        b[:n] += self.b @ u_of_v
        return control.ss(a, b, -(back + back_at_once @ y_of_x), -back_at_once @ y_of_v)

    def to_response(self, connection: str, omega: ArrayLike) -> control.FrequencyResponseData:
        """`open_loop`, exact, for the plots and margins of python-control.

        Args:
            omega: shape (k,) [rad/s].
        """
        import control

        omega = np.atleast_1d(np.asarray(omega, np.float64))
        return control.frd(self.open_loop(connection, omega), omega)

    def step_response(self, connection: str, time: ArrayLike) -> Array:
        """How the closed loop follows a step at a connection: L/(1 + L), by exact steps with lines between.

        Args:
            connection: as a link names it: what it carries is asked to change by 1.
            time: shape (k,), evenly spaced from 0 [s]; delays lie on lines between these instants.
        Returns: shape (k,).
        """
        time = np.asarray(time, np.float64)
        step, n, m = float(time[1] - time[0]), len(self.states), len(self.inputs)
        whole = np.zeros((n + 2 * m, n + 2 * m))
        whole[:n, :n], whole[:n, n : n + m] = self.a, self.b
        whole[n : n + m, n + m :] = np.eye(m) / step
        made = scipy.linalg.expm(whole * step)
        forward, ramp = made[:n, :n], made[:n, n + m :]
        hold = made[:n, n : n + m] - ramp
        late = [(delay / step, gains) for delay, gains in zip(self._delays, self._k, strict=True)]
        drive = np.zeros(m)
        own = [one for one in self.links if one.connection == connection]
        drive[[one.target for one in own]] = 1.0
        # What acts within the step: K0 and the share of delays shorter than it.
        now = sum((max(0.0, 1.0 - lag) * gains for lag, gains in late), np.zeros((m, len(self.outputs))))
        solved = np.linalg.inv(np.eye(m) - now @ (self.c @ ramp + self.d))
        x, outputs, found = np.zeros(n), np.zeros((len(time), len(self.outputs))), np.zeros(len(time))
        u = np.linalg.solve(np.eye(m) - self._at_once @ self.d, drive)
        outputs[0] = self.d @ u
        first = min(one.target for one in own)
        for index in range(len(time)):
            if index:
                fed = drive.copy()
                for lag, gains in late:
                    low = int(lag)
                    share = lag - low
                    for place, weight in ((index - low, 1.0 - share), (index - low - 1, share)):
                        if 0 <= place < index and weight:
                            fed = fed + weight * gains @ outputs[place]
                moved = forward @ x + hold @ u
                u = solved @ (fed + now @ (self.c @ moved))
                x = moved + ramp @ u
                outputs[index] = self.c @ x + self.d @ u
            for one in own:
                if one.target == first:
                    low = int(one.delay / step)
                    share = one.delay / step - low
                    for place, weight in ((index - low, 1.0 - share), (index - low - 1, share)):
                        if place >= 0:
                            found[index] -= weight * one.gain * outputs[place, one.source]
        return found

    def margins(self, connection: str, modes: Modes | None = None) -> Margins:
        """Margins of the loop through one connection, all crossovers considered.

        Raises: ConfigError if there is no such connection.
        """
        connection = self.connection(connection)
        modes = modes or self.modes()
        omega = self.frequencies(modes)
        self._open_all(1j * omega)

        def response(s: Complex) -> Complex:
            return self.response(connection, s)

        crossovers = []
        value = response(1j * omega)
        for w, falling in gain_crossovers(response, omega, value):
            angle = float(np.angle(-response(np.array([1j * w]))[0]))
            crossovers.append(Crossover(w, np.degrees(angle), float(np.mod(angle, 2.0 * np.pi)) / w, falling))
        real = _real_crossings(response, omega, value)
        # Where L does not integrate, the locus begins on the real axis: its first crossing is at no
        # frequency.
        still, lower = response(1j * omega[0] * np.array([1e-3, 1e-6]))
        if still.real < -_NO_GAIN and abs(lower - still) < 1e-6 * abs(still):
            real.insert(0, (0.0, float(-1.0 / still.real)))
        distance = abs(1.0 + value)
        peak = abs(value) / np.maximum(distance, 1e-300)
        near, least = _lowest(lambda w: abs(1.0 + response(1j * w)), omega, distance)
        with np.errstate(divide="ignore", invalid="ignore"):  # of a root on the axis
            top, most = _lowest(lambda w: -abs(1.0 - 1.0 / (1.0 + response(1j * w))), omega, -peak)
        far = float(np.max(abs(response(1j * omega[-1] * FAR))))
        return Margins(modes.unstable, tuple(crossovers), tuple(real), least, near, -most, top, far)

    def delay_margin(self, connections: Sequence[str] = (), modes: Modes | None = None) -> DelayMargin:
        """By how much connections may be later, all by the same delay, before the system is unstable.

        Args:
            connections: as links name them; all within feedback loops if none is named.
            modes: what `modes` gave.
        """
        names = tuple(self._named(connections)) or self.loops()
        modes = modes or self.modes()
        if modes.unstable or not names:
            return DelayMargin(names, np.nan if modes.unstable else np.inf, np.nan)
        found = borne_delay(lambda s: self._opened(names, s), self.frequencies(modes))
        return DelayMargin(names, *found)

    def frequencies(self, modes: Modes | None) -> Array:
        """Frequencies that show all of a loop, shape (k,) [rad/s]."""
        own = np.linalg.eigvals(self.a)
        poles = [*own, *(one.root for one in modes.modes)] if modes else []
        sizes = [abs(one) for one in (*(poles or own), *self._undelayed) if abs(one) > 1e-9]
        low, high = (min(sizes), max(sizes)) if sizes else (1.0, 1.0)
        longest = float(self._delays[-1])
        high = max(high, 20.0 / longest if longest else high)
        grid = [np.geomspace(1e-3 * low, 1e2 * high, 1500)]
        for one in poles:
            if abs(one.imag) > 0.0:
                # Close together around resonances, from their width out to the grid's distance.
                width = max(abs(one.real) / abs(one.imag), 1e-12)
                away = np.geomspace(
                    0.03 * width, max(0.1, width), 12 * int(np.ceil(np.log10(3.0 / width) + 2.0))
                )
                grid += [abs(one.imag) * (1.0 - away[away < 1.0]), abs(one.imag) * (1.0 + away)]
        every = np.concatenate(grid)
        return np.unique(every[every > 0.0])


def _lowest(function: Callable[[Any], Any], omega: Array, values: NDArray[Any]) -> tuple[float, float]:
    """Where a function is least and its value, near the lowest dips of its values on a grid."""
    place = int(np.argmin(values))
    inner = np.flatnonzero((values[1:-1] <= values[:-2]) & (values[1:-1] <= values[2:])) + 1
    chosen = inner[np.argsort(values[inner])][:_DIPS]
    at, least = minima(function, omega[chosen - 1], omega[chosen + 1])
    pairs = zip([omega[place], *at], [values[place], *least], strict=True)
    return min(((float(w), float(value)) for w, value in pairs), key=lambda one: one[1])


def _ends(connection: str) -> str:
    """A connection without its effects: "a.y -> b.u"."""
    parts = connection.split(" -> ")
    return f"{parts[0]} -> {parts[-1]}"


def _owner(port: str) -> str:
    """The block that a port belongs to: its instance, or a connection's filter."""
    return port if FILTER in port else port.partition(".")[0]


def _real_crossings(response: Any, omega: Array, value: Complex) -> list[tuple[float, float]]:
    """(omega, factor by which the gain may change there) where L is real and negative."""
    # What is as small as rounding has no sign, and no gain that anyone would reach makes it 1.
    clear = (abs(value.imag) > 1e-9 * abs(value)) & (abs(value) > _NO_GAIN)
    sign = np.where(clear, np.sign(value.imag), 0.0)
    index = np.flatnonzero((sign[:-1] * sign[1:] < 0.0) & (value.real[:-1] < 0.0) & (value.real[1:] < 0.0))
    at = zeros(lambda w: response(1j * w).imag, omega[index], omega[index + 1])
    factors = -1.0 / response(1j * at).real
    return [(float(w), float(factor)) for w, factor in zip(at, factors, strict=True) if factor > 0.0]
