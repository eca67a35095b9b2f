"""The system graph of a run as a drawing: instances with their FMUs, connections with units and effects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from typing import Any

from ..config.models import ConnectionModel, SystemModel
from .graph_layout import HEAD, LETTER, LINE, Box, Drawing, Node, Wire, lay_out

# Larger systems make no drawing that anybody reads.
_MOST_NODES, _MOST_WIRES = 40, 160
_COLORS = 7


@dataclass(frozen=True)
class Link:
    """A connection as the config has it: ports (instance, variable), and what happens on the way."""

    sources: tuple[tuple[str, str], ...]
    target: tuple[str, str]
    effects: str = ""

    def unit(self, units: Mapping[str, str]) -> str:
        """Of what it carries, where it was recorded."""
        name = ".".join(self.sources[0])
        return next((units[one] for one in (name, f"{name}[1]", f"{name}[1,1]") if one in units), "")


def links_of(model: SystemModel) -> list[Link]:
    """The connections of a config."""
    return [_link(one) for one in model.connections]


def _link(connection: str | ConnectionModel) -> Link:
    if isinstance(connection, str):
        source, _, target = connection.partition("->")
        return Link((_port(source),), _port(target))
    given = connection.source if isinstance(connection.source, list) else [connection.source]
    sources, labels = [], []
    for one in given:
        sources.append(_port(one if isinstance(one, str) else one.port))
        if not isinstance(one, str) and one.gain != 1:
            labels.append(f"{one.gain} x {one.port}")
    return Link(
        tuple(sources), _port(connection.target), ", ".join([*labels, *map(_effect, connection.through)])
    )


def _port(text: str) -> tuple[str, str]:
    instance, _, variable = text.strip().partition(".")
    return instance, variable


def _effect(one: Any) -> str:
    """As in the config, in short."""
    if not isinstance(one, Mapping):
        return str(one)
    if "effect" in one:
        rest = ", ".join(f"{key} {value}" for key, value in one.items() if key not in ("effect", "read"))
        return f"{str(one['effect']).rpartition(':')[2]} {rest}".strip()
    return ", ".join(
        f"{key} {' '.join(f'{k} {v}' for k, v in value.items()) if isinstance(value, Mapping) else value}"
        for key, value in one.items()
        if key not in ("read", "before", "seed")
    )


def draw_graph(model: SystemModel, units: Mapping[str, str]) -> str:
    """The drawing as SVG; empty for a system too large for one.

    Args:
        units: of recorded signals by name.
    """
    links = links_of(model)
    kinds = {name: one.fmu.rpartition("/")[2] for name, one in model.instances.items()}
    kinds |= dict.fromkeys(model.external, "over UDP")
    if len(kinds) > _MOST_NODES or sum(len(one.sources) for one in links) > _MOST_WIRES:
        return ""
    inputs: dict[str, dict[str, str]] = {name: {} for name in kinds}
    outputs: dict[str, dict[str, str]] = {name: {} for name in kinds}
    wires = []
    for link in links:
        inputs[link.target[0]][link.target[1]] = link.target[1]
        for number, source in enumerate(link.sources):
            unit = Link((source,), link.target).unit(units)
            outputs[source[0]][source[1]] = f"{source[1]} [{unit}]" if unit not in ("", "1") else source[1]
            wires.append(Wire(source, link.target, "" if number else link.effects))
    drawing = lay_out([Node(name, kind, inputs[name], outputs[name]) for name, kind in kinds.items()], wires)
    return _svg(drawing, model.title)


def _svg(drawing: Drawing, title: str) -> str:
    shapes = [_net(net, index) for index, net in enumerate(drawing.nets)]
    shapes += [_box(box) for box in drawing.boxes.values()]
    width, height = f"{drawing.width:.0f}", f"{drawing.height:.0f}"
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" role="img" aria-label="system graph of {escape(title)}" '
        f'width="{width}" height="{height}" viewBox="0 0 {width} {height}">{"".join(shapes)}</svg>'
    )


def _box(box: Box) -> str:
    node, x, y = box.node, box.x, box.y
    middle = f'x="{x + node.width / 2:.1f}" text-anchor="middle"'
    texts = [
        f'<text class="title" {middle} y="{y + 17:.1f}">{escape(node.name)}</text>',
        f'<text class="kind" {middle} y="{y + 32:.1f}">{escape(node.kind)}</text>',
    ]
    for ports, left in ((node.inputs, True), (node.outputs, False)):
        for index, text in enumerate(ports.values()):
            at, anchor = (x + 8, "start") if left else (x + node.width - 8, "end")
            texts.append(
                f'<text x="{at:.1f}" y="{y + HEAD + LINE * (index + 0.5) + 4:.1f}" '
                f'text-anchor="{anchor}">{escape(text)}</text>'
            )
    return (
        f'<g data-instance="{escape(node.name)}"><rect class="box" x="{x:.1f}" y="{y:.1f}" rx="6" '
        f'width="{node.width:.1f}" height="{node.height:.1f}"/>{"".join(texts)}</g>'
    )


def _net(net: Any, index: int) -> str:
    color = f"var(--series-{index % _COLORS})"
    title = "; ".join(
        f"{'.'.join(wire.source)} -> {'.'.join(wire.target)}" + (f" ({wire.tag})" if wire.tag else "")
        for wire in net.wires
    )
    path = " ".join("M" + " L".join(f"{x:.1f} {y:.1f}" for x, y in line) for line in net.lines)
    tips = "".join(
        f'<path class="tip" fill="{color}" d="M{x:.1f} {y:.1f} l-8 -4 v8 z"/>' for x, y in net.ends
    )
    tags = ""
    for x, y, text in net.tags:
        width = LETTER * len(text) + 10
        tags += (
            f'<rect class="effect" x="{x - width:.1f}" y="{y - 9:.1f}" '
            f'width="{width:.1f}" height="18" rx="8"/>'
            f'<text x="{x - width / 2:.1f}" y="{y + 4:.1f}" text-anchor="middle">{escape(text)}</text>'
        )
    return (
        f'<g class="wire" tabindex="0"><title>{escape(title)}</title>'
        f'<path class="net" stroke="{color}" d="{path}"/>{tips}{tags}</g>'
    )
