"""Where the boxes and wires of a system go: layers from left to right, wires at right angles.

Boxes stand in layers by the longest way that leads to them, once wires that close a loop are set aside. A
wire to the next layer goes through the channel between both; one that skips a layer goes above all boxes,
one that leads back below them, so that none crosses a box.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from ..base.graph import levels

# Measures of the drawing [px]: of a letter, a port's line, a box's head and what stands between things.
LETTER, LINE, HEAD = 6.7, 19.0, 42.0
_TRACK, _MARGIN, _GAP, _LANE = 10.0, 16.0, 26.0, 11.0
_SWEEPS = 6


@dataclass(frozen=True)
class Wire:
    """From an output to an input, (node, port) each; `tag` is what stands on its way."""

    source: tuple[str, str]
    target: tuple[str, str]
    tag: str = ""


@dataclass(frozen=True)
class Node:
    """A box to be placed: two lines of text at its head, and the texts of its ports."""

    name: str
    kind: str
    inputs: Mapping[str, str]
    outputs: Mapping[str, str]

    @property
    def width(self) -> float:
        """[px]"""
        texts = [max(map(len, ports.values()), default=0) for ports in (self.inputs, self.outputs)]
        return max(LETTER * (sum(texts) + 5), LETTER * 1.1 * max(len(self.name), len(self.kind)) + 20, 90.0)

    @property
    def height(self) -> float:
        """[px]"""
        return HEAD + LINE * max(len(self.inputs), len(self.outputs), 1) + 4


@dataclass
class Box:
    """A placed node: its upper left corner [px]."""

    node: Node
    x: float = 0.0
    y: float = 0.0

    def port(self, name: str, inputs: bool) -> tuple[float, float]:
        """Where a wire meets a port [px]."""
        ports = self.node.inputs if inputs else self.node.outputs
        y = self.y + HEAD + LINE * (list(ports).index(name) + 0.5)
        return (self.x if inputs else self.x + self.node.width), y


@dataclass
class Net:
    """All wires from one output: lines, ends (where an arrow points to) and tags with their right ends."""

    number: int
    source: tuple[str, str]
    wires: list[Wire]
    lines: list[list[tuple[float, float]]] = field(default_factory=list)
    ends: list[tuple[float, float]] = field(default_factory=list)
    tags: list[tuple[float, float, str]] = field(default_factory=list)


@dataclass
class Drawing:
    """What was laid out, and its size [px]."""

    boxes: dict[str, Box]
    nets: list[Net]
    width: float
    height: float


def lay_out(nodes: Sequence[Node], wires: Sequence[Wire]) -> Drawing:
    """Place boxes and wires.

    Args:
        nodes: in the order in which loops are entered.
        wires: between their ports.
    """
    layer = _layers(nodes, wires)
    rows = _ordered(nodes, wires, layer)
    boxes = {one.name: Box(one) for one in nodes}
    grouped: dict[tuple[str, str], Net] = {}
    for wire in wires:
        grouped.setdefault(wire.source, Net(len(grouped), wire.source, [])).wires.append(wire)
    nets = list(grouped.values())
    above = _lanes([net for net in nets if _reach(net, layer, 2)], layer)
    below = _lanes([net for net in nets if _reach(net, layer, None)], layer)
    top = _MARGIN + _LANE * len(above)
    tallest = max(sum(boxes[name].node.height + _GAP for name in row) - _GAP for row in rows)
    for row in rows:
        y = top + (tallest - sum(boxes[name].node.height + _GAP for name in row) + _GAP) / 2
        for name in row:
            boxes[name].y = y
            y += boxes[name].node.height + _GAP
    bottom = top + tallest
    x = _place_columns(rows, boxes, nets, layer, _MARGIN)
    lane_y = {net.number: top - _LANE * (index + 1) for index, net in enumerate(above)}
    back_y = {net.number: bottom + _LANE * (index + 1) for index, net in enumerate(below)}
    tracks = _tracks(rows, boxes, nets, layer)
    for net in nets:
        _route(net, boxes, layer, tracks, lane_y.get(net.number, 0.0), back_y.get(net.number, 0.0))
    return Drawing(boxes, nets, x, bottom + _LANE * len(below) + _MARGIN)


def _layers(nodes: Sequence[Node], wires: Sequence[Wire]) -> dict[str, int]:
    index = {one.name: number for number, one in enumerate(nodes)}
    below: list[list[int]] = [[] for _ in nodes]
    for wire in wires:
        source, target = index[wire.source[0]], index[wire.target[0]]
        if target not in below[source]:
            below[source].append(target)
    state = [0] * len(nodes)
    forward: list[list[int]] = [[] for _ in nodes]
    for root in range(len(nodes)):
        if state[root]:
            continue
        state[root] = 1
        work = [(root, iter(below[root]))]
        while work:
            node, rest = work[-1]
            for other in rest:
                if state[other] == 1:  # it closes a loop
                    continue
                forward[node].append(other)
                if state[other] == 0:
                    state[other] = 1
                    work.append((other, iter(below[other])))
                    break
            else:
                state[node] = 2
                work.pop()
    found = levels(forward)
    # What nothing leads to stands right before what it leads to.
    fed = {other for members in forward for other in members}
    for node, members in enumerate(forward):
        if node not in fed and members:
            found[node] = min(found[other] for other in members) - 1
    return {one.name: found[index[one.name]] for one in nodes}


def _ordered(nodes: Sequence[Node], wires: Sequence[Wire], layer: Mapping[str, int]) -> list[list[str]]:
    """Names per layer, neighbours near each other."""
    rows: list[list[str]] = [[] for _ in range(max(layer.values()) + 1)]
    for one in nodes:
        rows[layer[one.name]].append(one.name)
    beside: dict[str, list[str]] = defaultdict(list)
    for wire in wires:
        a, b = wire.source[0], wire.target[0]
        beside[a].append(b)
        beside[b].append(a)
    for _ in range(_SWEEPS):
        place = {name: (n + 0.5) / len(row) for row in rows for n, name in enumerate(row)}
        for row in rows:
            row.sort(key=lambda name: sum(place[o] for o in beside[name]) / max(len(beside[name]), 1))
    return rows


def _reach(net: Net, layer: Mapping[str, int], least: int | None) -> bool:
    """Whether a net has a wire that skips layers; with None, one that leads back or to its own layer."""
    spans = [layer[wire.target[0]] - layer[net.source[0]] for wire in net.wires]
    return any(span <= 0 for span in spans) if least is None else any(span >= least for span in spans)


def _lanes(nets: Sequence[Net], layer: Mapping[str, int]) -> list[Net]:
    """Shorter ones nearer to the boxes."""
    return sorted(
        nets, key=lambda net: max(abs(layer[wire.target[0]] - layer[net.source[0]]) for wire in net.wires)
    )


def _entries(nets: Sequence[Net], layer: Mapping[str, int], number: int) -> list[tuple[Net, Wire]]:
    """Wires that come into a layer from above or below."""
    return [
        (net, wire)
        for net in nets
        for wire in net.wires
        if layer[wire.target[0]] == number and layer[net.source[0]] != number - 1
    ]


def _place_columns(
    rows: Sequence[Sequence[str]],
    boxes: Mapping[str, Box],
    nets: Sequence[Net],
    layer: Mapping[str, int],
    x: float,
) -> float:
    """Give every box its x. Returns: the width of the drawing."""
    for number, row in enumerate(rows):
        leaving = sum(layer[net.source[0]] == number - 1 for net in nets)
        tags = [w.tag for net in nets for w in net.wires if w.tag and layer[w.target[0]] == number]
        tag = max((LETTER * len(text) + 24 for text in tags), default=0.0)
        x += _TRACK * (leaving + len(_entries(nets, layer, number)) + 2) + tag
        width = max(boxes[name].node.width for name in row)
        for name in row:
            boxes[name].x = x + (width - boxes[name].node.width) / 2
        x += width
    last = sum(layer[net.source[0]] == len(rows) - 1 for net in nets)
    return x + _TRACK * (last + 1) + _MARGIN


def _tracks(
    rows: Sequence[Sequence[str]], boxes: Mapping[str, Box], nets: Sequence[Net], layer: Mapping[str, int]
) -> dict[tuple[int, str, str], float]:
    """The x of every vertical line, by the net's number and the port that it comes from or leads to."""
    found: dict[tuple[int, str, str], float] = {}
    right = 0.0
    for number in range(len(rows) + 1):
        start = right
        rising: list[tuple[float, tuple[int, str, str]]] = []
        falling: list[tuple[float, tuple[int, str, str]]] = []
        for net in nets:
            if layer[net.source[0]] != number - 1:
                continue
            y = boxes[net.source[0]].port(net.source[1], inputs=False)[1]
            goals = [
                boxes[wire.target[0]].port(wire.target[1], inputs=True)[1]
                if layer[wire.target[0]] == number
                else (-1e6 if layer[wire.target[0]] > number else 1e6)
                for wire in net.wires
            ]
            up = sum(goals) / len(goals) < y
            (rising if up else falling).append((y, (net.number, *net.source)))
        order = [key for _, key in sorted(rising)] + [key for _, key in sorted(falling, reverse=True)]
        entering: list[tuple[bool, float, tuple[int, str, str]]] = []
        for net, wire in _entries(nets, layer, number):
            y = boxes[wire.target[0]].port(wire.target[1], inputs=True)[1]
            skips = layer[wire.target[0]] > layer[net.source[0]]
            entering.append((not skips, -y if skips else y, (net.number, *wire.target)))
        order += [key for _, _, key in sorted(entering)]
        for place, key in enumerate(order):
            found[key] = start + _TRACK * (place + 1.5)
        if number < len(rows):
            right = max(boxes[name].x + boxes[name].node.width for name in rows[number])
    return found


def _route(
    net: Net,
    boxes: Mapping[str, Box],
    layer: Mapping[str, int],
    tracks: Mapping[tuple[int, str, str], float],
    above: float,
    below: float,
) -> None:
    x0, y0 = boxes[net.source[0]].port(net.source[1], inputs=False)
    trunk = tracks[(net.number, *net.source)]
    for wire in net.wires:
        x1, y1 = boxes[wire.target[0]].port(wire.target[1], inputs=True)
        span = layer[wire.target[0]] - layer[net.source[0]]
        if span == 1:
            line = [(x0, y0), (trunk, y0), (trunk, y1), (x1, y1)]
        else:
            lane, rise = (above if span > 1 else below), tracks[(net.number, *wire.target)]
            line = [(x0, y0), (trunk, y0), (trunk, lane), (rise, lane), (rise, y1), (x1, y1)]
        net.lines.append(line)
        net.ends.append((x1, y1))
        if wire.tag:
            net.tags.append((x1 - 12, y1, wire.tag))
