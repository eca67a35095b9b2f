"""Graph algorithms against brute force."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from orchestrator.base.graph import levels, shortest_cycle, stable_order, strong_components

SIZE = 7
graphs = st.lists(st.lists(st.integers(0, SIZE - 1), max_size=3), min_size=SIZE, max_size=SIZE)


def reachable(successors, start):
    seen, stack = set(), list(successors[start])
    while stack:
        node = stack.pop()
        if node not in seen:
            seen.add(node)
            stack += successors[node]
    return seen


@given(graphs)
def test_components_are_the_classes_of_mutual_reach(successors):
    reach = [reachable(successors, node) for node in range(SIZE)]
    found = strong_components(successors)
    assert sorted(node for component in found for node in component) == list(range(SIZE))
    home = {node: index for index, component in enumerate(found) for node in component}
    for one in range(SIZE):
        for other in range(SIZE):
            together = one == other or (other in reach[one] and one in reach[other])
            assert (home[one] == home[other]) == together


@given(graphs)
def test_order_respects_every_edge_that_is_on_no_cycle(successors):
    order = stable_order(successors)
    assert sorted(order) == list(range(SIZE))
    place = {node: index for index, node in enumerate(order)}
    for node, below in enumerate(successors):
        for other in below:
            if node not in reachable(successors, other):
                assert place[node] < place[other]


def test_order_keeps_to_numbers_where_edges_leave_it_open():
    assert stable_order([[], [], []]) == (0, 1, 2)
    assert stable_order([[], [0], []]) == (1, 0, 2)
    assert stable_order([[1], [0], []]) == (0, 1, 2)


@given(graphs)
def test_shortest_cycle_is_a_cycle_and_none_is_shorter(successors):
    for start in range(SIZE):
        cycle = shortest_cycle(successors, start, range(SIZE))
        if start not in reachable(successors, start):
            assert cycle == []
            continue
        assert cycle[0] == start
        for node, after in zip(cycle, [*cycle[1:], start], strict=True):
            assert after in successors[node]
        frontier, length = set(successors[start]), 1
        while start not in frontier:
            frontier, length = {other for node in frontier for other in successors[node]}, length + 1
        assert len(cycle) == length


def test_levels_are_longest_paths():
    assert levels([[1, 2], [2], [3], [], [3]]) == [0, 1, 2, 3, 0]
