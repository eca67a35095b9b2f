"""Observed orders of convergence on the docking loop, against its delay-differential equation."""

from __future__ import annotations

from fractions import Fraction
from importlib import import_module
from pathlib import Path

import pytest


@pytest.fixture(scope="module")
def convergence():
    with pytest.MonkeyPatch.context() as patched:
        patched.syspath_prepend(Path(__file__).parents[2])
        yield import_module("tests.benchmarks.convergence")


@pytest.fixture(scope="module")
def first_contact(convergence):
    """The loop until its first contact is over."""
    return convergence.docking(Fraction(1, 2))


ITERATIVE = {"name": "iterative", "tolerance": 1e-8}


@pytest.mark.parametrize(
    ("master", "order"),
    [
        ("jacobi", 1),
        ("gauss-seidel", 1),
        ({"name": "jacobi", "extrapolation": 1}, 2),
        ({"name": "gauss-seidel", "extrapolation": 1}, 2),
        (ITERATIVE, 1),
        ({**ITERATIVE, "interpolation": 1}, 2),
    ],
    ids=str,
)
def test_orders_on_the_docking_loop(master, order, convergence, first_contact):
    runs = convergence.measure(first_contact, convergence.fixed("", master, Fraction(1, 1000), 3))
    assert convergence.orders(runs) == pytest.approx([order] * 2, abs=0.3)


def test_power_converges_on_two_masses_with_its_tolerance(convergence):
    _, power = convergence.dividing("link.on_one", Fraction(1, 5), [], [1e-2, 1e-3, 1e-4, 1e-5])
    runs = convergence.measure(convergence.two_masses(), power)
    # Energy per part is of fourth order in its size, the error of the whole of second.
    assert all(order > 0.5 for order in convergence.orders(runs))
    assert runs[-1].error < 5e-5 and runs[-1].steps < 3000


def test_the_table_and_the_figures_are_written(convergence, tmp_path, capsys, monkeypatch):
    def two_masses(coarsest, count, tight):
        return [convergence.fixed("gauss-seidel", "gauss-seidel", coarsest, 2)]

    monkeypatch.setattr(convergence, "masters", two_masses)
    monkeypatch.setattr(convergence, "dividing", lambda *arguments: [])
    convergence.main(["--quick", "--out", str(tmp_path)])
    printed = capsys.readouterr().out
    assert "two masses, 4 s" in printed and "docking loop, 1.2 s" in printed
    assert sorted(one.name for one in tmp_path.iterdir()) == [
        "convergence-docking-loop.png",
        "convergence-two-masses.png",
    ]
