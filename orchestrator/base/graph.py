"""Graph algorithms on nodes numbered from 0; linear in nodes and edges."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Sequence

Successors = Sequence[Sequence[int]]


def strong_components(successors: Successors) -> list[list[int]]:
    """Strongly connected components, each in ascending order; Tarjan's algorithm without recursion.

    Args:
        successors: per node, the nodes its edges lead to.
    """
    count = len(successors)
    found, low = [-1] * count, [0] * count
    on_stack = [False] * count
    stack: list[int] = []
    components: list[list[int]] = []
    number = 0
    for root in range(count):
        if found[root] >= 0:
            continue
        work = [(root, 0)]
        while work:
            node, edge = work.pop()
            if edge == 0:
                found[node] = low[node] = number
                number += 1
                stack.append(node)
                on_stack[node] = True
            below = successors[node]
            if edge > 0:
                low[node] = min(low[node], low[below[edge - 1]])
            descended = False
            for position in range(edge, len(below)):
                other = below[position]
                if found[other] < 0:
                    work.append((node, position + 1))
                    work.append((other, 0))
                    descended = True
                    break
                if on_stack[other]:
                    low[node] = min(low[node], found[other])
            if descended:
                continue
            if low[node] == found[node]:
                component = []
                while True:
                    other = stack.pop()
                    on_stack[other] = False
                    component.append(other)
                    if other == node:
                        break
                components.append(sorted(component))
    return components


def _homes(successors: Successors) -> tuple[list[list[int]], list[int]]:
    """Strong components, and per node the number of its own."""
    components = strong_components(successors)
    home = [0] * len(successors)
    for index, component in enumerate(components):
        for node in component:
            home[node] = index
    return components, home


def stable_order(successors: Successors) -> tuple[int, ...]:
    """Topological order; nodes that no edge orders, and those of one cycle, stay in ascending order."""
    components, home = _homes(successors)
    waiting = [0] * len(components)
    for node, below in enumerate(successors):
        for other in below:
            if home[other] != home[node]:
                waiting[home[other]] += 1
    ready = [(component[0], index) for index, component in enumerate(components) if waiting[index] == 0]
    heapq.heapify(ready)
    order: list[int] = []
    while ready:
        _, index = heapq.heappop(ready)
        order += components[index]
        for node in components[index]:
            for other in successors[node]:
                if home[other] != index:
                    waiting[home[other]] -= 1
                    if waiting[home[other]] == 0:
                        heapq.heappush(ready, (components[home[other]][0], home[other]))
    return tuple(order)


def levels(successors: Successors) -> list[int]:
    """Per node, the length of the longest path that leads to it; nodes of one cycle count as one."""
    components, home = _homes(successors)
    level = [0] * len(components)
    for index in reversed(range(len(components))):  # Tarjan's algorithm finds what is last first
        for node in components[index]:
            for other in successors[node]:
                if home[other] != index:
                    level[home[other]] = max(level[home[other]], level[index] + 1)
    return [level[index] for index in home]


def shortest_cycle(successors: Successors, start: int, within: Sequence[int]) -> list[int]:
    """The shortest cycle through a node: its nodes in order, beginning with `start`; empty if there is none.

    Args:
        within: the nodes that the cycle may visit.
    """
    allowed = set(within)
    came_from: dict[int, int] = {}
    queue = deque([start])
    while queue:
        node = queue.popleft()
        for other in successors[node]:
            if other == start:
                path = [node]
                while path[-1] != start:
                    path.append(came_from[path[-1]])
                return path[::-1]
            if other in allowed and other not in came_from:
                came_from[other] = node
                queue.append(other)
    return []
