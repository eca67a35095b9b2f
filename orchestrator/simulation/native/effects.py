"""Connections with effects in machine code, from tables: the same as `system.running_connections`."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numba import carray, cfunc, njit, types
from numba.extending import register_jitable
from numpy.typing import NDArray

from ...effects import Effect, Kernel, delay, draws
from ...effects.choose import BUILT_IN, built_in
from ...fmi import Array
from ...master.running_instances import Instances
from .foreign_calls import as_doubles, call_effect, load, store
from .plain_steps import word as _word
from .table_columns import Chained, Path

_PLACE, _FIRST_LEG, _END_LEG, _FIRST_LINK, _END_LINK = map(int, Path)
_KIND, _FUNCTION, _X, _X_COUNT, _FIRST_READ, _OPTIONS, _OPTION_COUNT, _MEMORY, _MEMORY_COUNT = map(
    int, Chained
)
_PATH_ROW, _LINK_ROW = 8 * len(Path), 8 * len(Chained)  # bytes
_FOREIGN = -1

_DOUBLES = types.CPointer(types.float64)
_SIGNATURE = types.float64(
    types.float64, _DOUBLES, types.int64, _DOUBLES, types.int64, _DOUBLES, types.int64, types.int64
)

# Functions that kernels share.
for _shared in (draws._mixed, draws._seeded, draws.uniform, draws.normal, delay.earlier):
    register_jitable(_shared)


def _choice(code: int, kernel: Kernel, otherwise: Callable[..., Any]) -> Callable[..., Any]:
    """A function that is the kernel for its code, and another one for others."""
    kernel = register_jitable(kernel)

    def apply(kind, time, x, options, memory, commit):
        if kind == code:
            return kernel(time, x, options, memory, commit)
        return otherwise(kind, time, x, options, memory, commit)

    # numba calls machine code by names that are counted in each process: what two processes kept on disk
    # would call each other's functions of the same name.
    apply.__qualname__ = f"apply_{code}"
    return register_jitable(forceinline=True)(apply)


@register_jitable
def _none(kind, time, x, options, memory, commit):
    return math.nan


def _all_choices() -> Callable[..., Any]:
    chosen: Callable[..., Any] = _none
    for code, name in reversed(list(enumerate(BUILT_IN))):
        chosen = _choice(code, built_in(name).kernel, chosen)
    return chosen


_apply = _all_choices()


@register_jitable
def evaluate(path, links, legs, gains, offsets, reads, values, time, commit):
    """Put the value of a connection with effects into its place.

    Args:
        path: address of its row in the table of connections.
        links: address of the table of effects.
        legs, gains, offsets: addresses of the places of all summands, their gains and offsets.
        reads: address of the places of further signals.
        values: address of the signals.
        time: the instant [s].
        commit: whether it is accepted.
    """
    total = 0.0
    for index in range(_word(path, _FIRST_LEG), _word(path, _END_LEG)):
        term = load(values + 8 * _word(legs, index), np.float64(0))
        gain, offset = load(gains + 8 * index, np.float64(0)), load(offsets + 8 * index, np.float64(0))
        if gain != 1.0 or offset != 0.0:
            term = gain * term + offset
        total = term if index == _word(path, _FIRST_LEG) else total + term
    for index in range(_word(path, _FIRST_LINK), _word(path, _END_LINK)):
        if not math.isfinite(total):
            break
        link = links + _LINK_ROW * index
        x = _word(link, _X)
        store(x, total)
        count = _word(link, _X_COUNT)
        for further in range(count - 1):
            place = _word(reads, _word(link, _FIRST_READ) + further)
            store(x + 8 * (1 + further), load(values + 8 * place, np.float64(0)))
        if _word(link, _KIND) == _FOREIGN:
            total = call_effect(
                _word(link, _FUNCTION),
                time,
                x,
                count,
                _word(link, _OPTIONS),
                _word(link, _OPTION_COUNT),
                _word(link, _MEMORY),
                _word(link, _MEMORY_COUNT),
                np.int64(commit),
            )
        else:
            total = _apply(
                _word(link, _KIND),
                time,
                carray(as_doubles(x), (count,)),
                carray(as_doubles(_word(link, _OPTIONS)), (_word(link, _OPTION_COUNT),)),
                carray(as_doubles(_word(link, _MEMORY)), (_word(link, _MEMORY_COUNT),)),
                commit,
            )
    store(values + 8 * _word(path, _PLACE), total)


@cache
def _compiled(kernel: Kernel) -> Any:
    """A kernel of a user as a C function."""
    inner = njit(kernel)

    @cfunc(_SIGNATURE)
    def call(time, x, x_count, options, option_count, memory, memory_count, commit):
        return inner(
            time,
            carray(x, (x_count,)),
            carray(options, (option_count,)),
            carray(memory, (memory_count,)),
            commit != 0,
        )

    return call


def unfit(effect: Effect) -> str:
    """Why an effect cannot run in machine code; empty if it can."""
    if type(effect) in (built_in(name) for name in BUILT_IN):
        return ""
    if not effect.jittable:
        return "is Python code"
    try:
        _compiled(effect.kernel)
    except Exception as error:  # numba refuses in many ways
        return f"cannot be compiled ({str(error).strip().splitlines()[-1].strip()})"
    return ""


@dataclass(frozen=True)
class Wiring:
    """Tables of the connections with effects; see `evaluate`.

    Attributes:
        paths, links: shapes (n, len(Path)) and (m, len(Chained)).
        after: numbers of the connections to evaluate after each instance, `bounds` where each one's begin and
            end, shape (instances + 1,).
        kept: what is there by address.
    """

    paths: NDArray[np.int64]
    links: NDArray[np.int64]
    legs: NDArray[np.int64]
    gains: Array
    offsets: Array
    reads: NDArray[np.int64]
    after: NDArray[np.int64]
    bounds: NDArray[np.int64]
    kept: tuple[Any, ...]

    @staticmethod
    def of(instances: Instances, step_size: float) -> Wiring:
        """The tables of instances that are initialised, with room for instants `step_size` apart [s]."""
        layout = instances.layout
        paths, links, reads = [], [], []
        legs, gains, offsets = [], [], []
        kept: list[Any] = []
        if instances.connections is not None:
            instances.connections.reserve(step_size)
        kinds = {built_in(name): code for code, name in enumerate(BUILT_IN)}
        for number, one in enumerate(layout.wired):
            assert instances.connections is not None
            first_leg, first_link = len(legs), len(links)
            legs += one.source.tolist()
            gains += one.gain.tolist()
            offsets += one.offset.tolist()
            for position, (effect, places) in enumerate(one.links):
                x, options = np.zeros(1 + len(places)), np.array(effect.numbers(), np.float64)
                memory = instances.connections.memories[number][position]
                kind = kinds.get(type(effect), _FOREIGN)
                function = _compiled(effect.kernel) if kind == _FOREIGN else None
                address = 0 if function is None else function.address
                arrays = (options.ctypes.data, len(options), memory.ctypes.data, len(memory))
                links.append([kind, address, x.ctypes.data, len(x), len(reads), *arrays])
                reads += places.tolist()
                kept += [x, options, memory, function]
            paths.append([one.place, first_leg, len(legs), first_link, len(links)])
        number_of = {one.place: number for number, one in enumerate(layout.wired)}
        after = [[number_of[one.place] for one in wired] for wired in layout.wired_after]
        return Wiring(
            paths=_whole(paths).reshape(-1, len(Path)),
            links=_whole(links).reshape(-1, len(Chained)),
            legs=_whole(legs),
            gains=np.array(gains, np.float64),
            offsets=np.array(offsets, np.float64),
            reads=_whole(reads),
            after=_whole([number for numbers in after for number in numbers]),
            bounds=_whole(np.cumsum([0, *map(len, after)])),
            kept=tuple(kept),
        )


def _whole(values: Any) -> NDArray[np.int64]:
    return np.array(values, np.int64)
