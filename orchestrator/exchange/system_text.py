"""A system as data for runtime/coupled: what resources/system.txt of its FMU says, as reading.c takes it."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from typing import Any

from ..base.errors import ConfigError, Problem
from ..fmi import Causality, Value, Variable
from ..system.connection import Connection, Port
from .system_contents import Inside, Outer, effect_number

TIME = "time"
"""Name of the independent variable, which comes first."""

# The types of runtime/coupled/system.h.
_TYPES = {
    "Real": 0, "Float64": 0, "Float32": 1, "Int8": 2, "UInt8": 3, "Int16": 4, "UInt16": 5, "Integer": 6,
    "Int32": 6, "UInt32": 7, "Int64": 8, "UInt64": 9, "Boolean": 10, "String": 11,
}  # fmt: skip
_KINDS = {"Real": 0, "Integer": 1, "Boolean": 2}
_TIME, _SIGNAL, _INPUT, _PARAMETER = range(4)
_LARGEST = 2**53


def system_text(inside: Inside, name: str, token: str, folders: Sequence[str]) -> str:
    """The text.

    Args:
        name: of the exported FMU.
        token: its GUID or instantiation token.
        folders: of the FMUs of `inside.fmus`, below resources/.
    Raises: ConfigError if times or inputs are not of a kind that the text can hold.
    """
    return _Writer(inside).write(name, token, folders)


def _bits(value: Any) -> str:
    return struct.pack(">d", float(value)).hex()


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace("\t", "\\t").replace("\n", "\\n")


class _Writer:
    def __init__(self, inside: Inside) -> None:
        self._inside, self._system, self._layout = inside, inside.system, inside.layout
        self._lines: list[str] = []
        self._number = {one.place: number for number, one in enumerate(self._layout.wired)}
        self._made = {one.connection.target: one for one in self._layout.wired}

    def write(self, name: str, token: str, folders: Sequence[str]) -> str:
        layout, inside = self._layout, self._inside
        self._line("orchestrator-system", 1, _escaped(token), _escaped(name))
        self._grid()
        self._line("master", int(inside.late))
        count = sum(len(one.names) for one in layout.inputs) + len(inside.inputs)
        self._line("sizes", layout.size, layout.size - len(layout.wired), count, len(inside.inputs))
        self._libraries(folders)
        for index in range(len(self._system.instances)):
            self._instance(index)
        self._starts()
        for index in inside.order:
            self._line("order", index)
        self._ports()
        self._wires()
        self._initial()
        self._variables()
        return "".join(f"{line}\n" for line in self._lines)

    def _line(self, *fields: Any) -> None:
        self._lines.append("\t".join(str(field) for field in fields))

    def _grid(self) -> None:
        grid = self._inside.prepared.grid
        denominator = grid.start.denominator * grid.step_size.denominator
        begin = grid.start.numerator * grid.step_size.denominator
        stride = grid.step_size.numerator * grid.start.denominator
        if max(abs(begin), stride, denominator) > _LARGEST // 2**20:
            run = self._inside.prepared.config.model.run
            what = f"the step size {run.step_size}, from {run.start_time} onwards, has too many digits"
            raise ConfigError([Problem("run.step_size", what, "nine digits are possible inside an FMU")])
        self._line("grid", begin, stride, denominator, _bits(grid.step_size))

    def _libraries(self, folders: Sequence[str]) -> None:
        found = {one.fmu.path: one.fmu.description for one in self._system.instances}
        for path, folder in zip(self._inside.fmus, folders, strict=True):
            one = found[path]
            able = one.capabilities
            self._line(
                "library", one.fmi_version[0], one.model_identifier, folder, _escaped(one.token),
                int(able.save_state), int(able.serialise_state),
            )  # fmt: skip

    def _instance(self, index: int) -> None:
        one, inputs = self._system.instances[index], self._layout.inputs[index]
        count = len(inputs.names) + len(self._externals(one.name))
        self._line(
            "instance", _escaped(one.name), self._inside.fmus.index(one.fmu.path), one.ratio.numerator,
            one.ratio.denominator, int(inputs.gain is not None), count,
        )  # fmt: skip

    def _externals(self, instance: str) -> list[tuple[int, Outer]]:
        return [pair for pair in enumerate(self._inside.inputs) if pair[1].port.instance == instance]

    def _starts(self) -> None:
        for index, one in enumerate(self._system.instances):
            given: dict[str, Value] = dict(one.start)
            for _, outer in self._externals(one.name):
                assert outer.start is not None
                given.setdefault(outer.port.variable, outer.start)
            arrays: dict[int, list[Value]] = {}
            for name, value in given.items():
                variable = one.variable(name)
                if variable.elements > 1:
                    arrays.setdefault(variable.reference, self._whole(index, variable))[variable.element] = (
                        value
                    )
                elif isinstance(value, str):
                    self._line("start", index, _TYPES["String"], variable.reference, _escaped(value))
                else:
                    self._line("start", index, self._type(index, variable), variable.reference, _bits(value))
            for reference, values in arrays.items():
                kind = next(v for v in one.fmu.description.variables.values() if v.reference == reference)
                numbers = " ".join(_bits(value) for value in values)
                self._line("start", index, self._type(index, kind), reference, numbers)

    def _whole(self, index: int, variable: Variable) -> list[Value]:
        """Start values of all elements of an array, as its FMU declares them."""
        variables = self._system.instances[index].fmu.description.variables.values()
        own = sorted((v for v in variables if v.reference == variable.reference), key=lambda v: v.element)
        return [0.0 if one.start is None else one.start for one in own[: variable.elements]]

    def _type(self, index: int, variable: Variable) -> int:
        if variable.type == "Enumeration":
            third = self._system.instances[index].fmu.description.fmi_version.startswith("3")
            return _TYPES["Int64" if third else "Integer"]
        return _TYPES[variable.type]

    def _ports(self) -> None:
        """Blocks of every instance, and what feeds the inputs."""
        layout, first, feeds = self._layout, 0, []
        for index, one in enumerate(self._system.instances):
            inputs = layout.inputs[index]
            names = list(inputs.names)
            for position, source in enumerate(inputs.source.tolist()):
                gain = 1.0 if inputs.gain is None else inputs.gain[position]
                offset = 0.0 if inputs.offset is None else inputs.offset[position]
                feeds.append((source, gain, offset))
            for number, outer in self._externals(one.name):
                names.append(outer.port.variable)
                feeds.append((-1 - number, 1.0, 0.0))
            self._blocks(index, 0, names, first)
            self._blocks(index, 1, layout.outputs[index], layout.spans[index].start)
            first += len(names)
        for source, gain, offset in feeds:
            self._line("feed", source, _bits(gain), _bits(offset))

    def _blocks(self, index: int, getting: int, names: Iterable[str], first: int) -> None:
        one = self._system.instances[index]
        groups: dict[int, list[tuple[int, Variable]]] = {}
        for place, name in enumerate(names, start=first):
            variable = one.variable(name)
            groups.setdefault(self._type(index, variable), []).append((place, variable))
        for kind, ports in groups.items():
            offsets: dict[int, int] = {}
            places: list[int] = []
            for _, variable in ports:
                if variable.reference not in offsets:
                    offsets[variable.reference] = len(places)
                    places += [-1] * variable.elements
            for place, variable in ports:
                slot = offsets[variable.reference] + variable.element
                if places[slot] >= 0 and getting:  # another name of the same: a call of its own
                    self._block(index, getting, kind, [variable.reference], [place])
                else:
                    places[slot] = place
            if not getting and -1 in places:
                what = f"of an input array of {one.name} only some elements are fed"
                raise ConfigError(
                    [Problem(f"instances.{one.name}", what, "inside an FMU it is all of them, or none")]
                )
            self._block(index, getting, kind, offsets, places)

    def _block(self, index: int, getting: int, kind: int, references: Any, places: Any) -> None:
        self._line("block", index, getting, kind, " ".join(map(str, references)), " ".join(map(str, places)))

    def _wires(self) -> None:
        step = float(self._inside.prepared.grid.step_size)
        wired = self._layout.wired
        for one in wired:
            self._line("path", one.place, len(one.source), len(one.links))
        for one in wired:
            for source, gain, offset in zip(one.source.tolist(), one.gain, one.offset, strict=True):
                self._line("leg", source, _bits(gain), _bits(offset))
        for one in wired:
            for effect, reads in one.links:
                options = " ".join(map(_bits, effect.numbers()))
                self._line(
                    "link",
                    effect_number(effect),
                    options,
                    " ".join(map(str, reads.tolist())),
                    effect.room(step),
                )
        for index, after in enumerate(self._layout.wired_after):
            for one in after:
                self._line("after", index, self._number[one.place])

    def _initial(self) -> None:
        """How initial values are passed on, see orchestrator.system.initialisation."""
        for loops, connections in zip(self._system.initial_loops, self._system.initial_levels, strict=True):
            for loop in loops:
                reads = list(dict.fromkeys(port for one in loop for port in one.sources))
                self._line("loop", len(reads), len(loop))
                self._exchange(reads, loop)
            by_instance: dict[str, dict[Port, None]] = {}
            for one in connections:
                for port in one.sources:
                    by_instance.setdefault(port.instance, {})[port] = None
            self._exchange([port for ports in by_instance.values() for port in ports], connections)

    def _exchange(self, reads: Iterable[Port], connections: Iterable[Connection]) -> None:
        for port in reads:
            nominal = self._system.variable(port).nominal
            self._line("read", *self._at(port), self._layout.index[port], _bits(nominal))
        for one in connections:
            made = self._made.get(one.target)
            place = self._layout.index[one.source] if made is None else made.place
            path = -1 if made is None else self._number[made.place]
            self._line("give", *self._at(one.target), place, path, _bits(one.gain), _bits(one.offset))

    def _at(self, port: Port) -> tuple[int, int, int, int, int]:
        index, variable = self._system.position[port.instance], self._system.variable(port)
        return index, self._type(index, variable), variable.reference, variable.element, variable.elements

    def _variables(self) -> None:
        """Variables of the exported FMU, by value reference."""
        self._line("variable", _TIME, 0, 0, 0, 0, 0, 0, 0, 1, TIME)
        inside = self._inside
        inputs = {one.port: number for number, one in enumerate(inside.inputs)}
        for one in (*inside.inputs, *inside.outputs, *inside.parameters):
            kind, place, tunable = _PARAMETER, 0, 0
            if one.causality is Causality.INPUT:
                kind, place = _INPUT, inputs[one.port]
            elif one.causality is Causality.OUTPUT:
                kind, place = _SIGNAL, self._layout.index[one.port]
            else:
                tunable = int(one.variable.variability == "tunable")
            fields = (kind, _KINDS[one.type], place, tunable, *self._at(one.port), _escaped(str(one.port)))
            self._line("variable", *fields)
