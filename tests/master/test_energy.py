"""The coupling ledger: energies against closed balances, signs, orders, effects and loops."""

from __future__ import annotations

import csv
import json
from fractions import Fraction
from importlib.util import find_spec
from itertools import pairwise
from math import log2

import numpy as np
import pytest
from assembled import assemble
from coupled import PERIOD, created, energy, every_master, moved_spring, simulated, two_masses
from doubles import gain, mass, spring

from orchestrator.base.errors import ConfigError
from orchestrator.cli.main import main
from orchestrator.config import BondModel
from orchestrator.master.energy import Ledger
from orchestrator.results.recorders import Recorder
from orchestrator.simulation.loop import simulate
from orchestrator.simulation.native import loop as native_loop
from orchestrator.simulation.run import prepare, run
from orchestrator.system.assembly import Part


@every_master
def test_what_the_bonds_create_is_what_the_whole_gains(name):
    """Every component conserves energy exactly, so that all drift of the sum is the coupling's."""
    results, ledger = simulated(two_masses(), name, 60)
    time, course = ledger.energies_over_time()
    drift = energy(results) - energy(results)[0]
    assert time.tolist() == results.time.tolist()
    assert sum(column[:, 2] for column in course.values()) == pytest.approx(drift, rel=1e-9, abs=1e-11)
    assert np.abs(drift).max() > 1e-13 or "interpolation" in str(name)
    for account in ledger.accounts().values():
        assert sum(account.parts.values()) == pytest.approx(account.created, abs=1e-12)
        assert account.taken - account.given == pytest.approx(account.created, abs=1e-12)


@pytest.mark.parametrize("name", ["jacobi", "gauss-seidel"])
@pytest.mark.parametrize(
    "ratios", [{"link": 3}, {"a": 2}, {"a": 2, "b": 3}, {"a": Fraction(1, 2)}, {"a": 4, "link": 2}], ids=str
)
def test_instances_with_a_step_of_their_own_are_in_the_books(name, ratios):
    system = two_masses(**{key: Fraction(value) for key, value in ratios.items()})
    results, ledger = simulated(system, name, 60)
    drift = energy(results)[-1] - energy(results)[0]
    assert abs(drift) > 1e-3
    assert created(ledger) == pytest.approx(drift, rel=1e-9, abs=1e-11)


def velocity_oscillator():
    return assemble(
        [Part("spring", moved_spring(4.0)), Part("mass", mass(), {"velocity": "1 m/s"})],
        ["mass.velocity -> spring.velocity", "spring.force -> mass.force"],
    )


@pytest.mark.parametrize("name", ["jacobi", "gauss-seidel", {"name": "jacobi", "extrapolation": 1}], ids=str)
def test_flows_are_integrated_exactly_where_inputs_are_held(name):
    results, ledger = simulated(velocity_oscillator(), name, 50)
    whole = results["mass.velocity"] ** 2 / 2 + results["spring.energy"]
    _, course = ledger.energies_over_time()
    assert course["spring-mass"][:, 2] == pytest.approx(whole - whole[0], rel=1e-9, abs=1e-12)
    assert np.abs(whole - whole[0]).max() > 1e-4


@pytest.mark.parametrize(
    ("name", "order"),
    [
        ("jacobi", 1),
        ({"name": "iterative", "tolerance": 1e-12}, 1),
        ({"name": "jacobi", "extrapolation": 1}, 2),
    ],
    ids=str,
)
def test_what_is_created_vanishes_with_the_masters_order(name, order):
    found = [abs(created(simulated(velocity_oscillator(), name, steps, 1)[1])) for steps in (200, 400, 800)]
    assert [log2(one / other) for one, other in pairwise(found)] == pytest.approx([order] * 2, abs=0.1)


def oscillator():
    return assemble(
        [Part("mass", mass(), {"position": "1 m"}), Part("spring", spring())],
        ["mass.position -> spring.position", "spring.force -> mass.force"],
    )


def test_jacobi_adds_energy_at_every_instant_and_iterative_takes_it():
    """The held inputs of Jacobi are late, those of the iteration early; the error is of first order."""
    _, late = simulated(oscillator(), "jacobi", 600, 6)
    _, early = simulated(oscillator(), {"name": "iterative", "tolerance": 1e-12}, 600, 6)
    for ledger, sign in ((late, 1.0), (early, -1.0)):
        _, course = ledger.energies_over_time()
        per_second = np.diff(sign * course["spring-mass"][::100, 2])
        assert (per_second > 0.0).all()
    # Over a period: the position is held half a step late, the force is a whole one behind the spring's own.
    _, whole = simulated(oscillator(), "jacobi", 880, PERIOD)
    force, position = whole.accounts()["spring-mass"].parts.values()
    assert force == pytest.approx(2.0 * position, rel=0.01)
    assert position == pytest.approx(float(PERIOD) / 880 / 2.0 * np.pi, rel=0.05)


def test_gauss_seidel_takes_back_part_of_what_it_gives():
    """The position of the step's end comes half a step early: of Jacobi's 3/2 steps of delay 1/2 is left."""
    _, early = simulated(oscillator(), "gauss-seidel", 880, PERIOD)
    _, late = simulated(oscillator(), "jacobi", 880, PERIOD)
    account = early.accounts()["spring-mass"]
    force, position = account.parts.values()
    assert position == pytest.approx(-0.5 * force, rel=0.02)
    assert account.created == pytest.approx(late.accounts()["spring-mass"].created / 3.0, rel=0.05)


@pytest.mark.parametrize("loop", ["python", "native"])
def test_the_course_of_a_long_run_is_thinned_and_its_sums_are_not(monkeypatch, loop):
    if loop == "native":
        pytest.importorskip("numba")
    prepared = prepare("docking-1d-uncompensated", ["satellite.form=native", "run.stop_time=0.5 s"])
    found = []
    for most in (1 << 16, 100):
        monkeypatch.setattr("orchestrator.master.energy.ledger._MOST_KEPT", most)
        ledger = Ledger(prepared.system)
        simulate(prepared.system, prepared.master, prepared.grid, loop=loop, ledger=ledger)
        found.append((*ledger.energies_over_time(), ledger.summary()))
    (times, whole, summary), (fewer, course, other) = found
    every = next(n for n in (2**power for power in range(20)) if len(times[::n]) <= 100)
    assert fewer.tolist() == times[::every].tolist()
    assert course["contact-satellite"] == pytest.approx(whole["contact-satellite"][::every], abs=1e-15)
    assert other["contact-satellite"]["created"] == pytest.approx(summary["contact-satellite"]["created"])


# Effects on the connections of a bond.


def through(*effects, on="force"):
    ends = {
        "position": ["mass.position", "spring.position"],
        "force": ["spring.force", "mass.force"],
    }
    return assemble(
        [Part("mass", mass(), {"position": "1 m"}), Part("spring", spring())],
        [
            {"from": source, "to": target, "through": list(effects) if name == on else []}
            for name, (source, target) in ends.items()
        ],
        step_size=0.01,
    )


@every_master
def test_effects_of_zero_size_change_nothing_in_the_books(name):
    _, plain = simulated(oscillator(), name, 60)
    for on in ("position", "force"):
        _, other = simulated(through({"delay": "0 s"}, {"gain": 1}, on=on), name, 60)
        (one,), (two,) = plain.accounts().values(), other.accounts().values()
        assert (two.taken, two.given, two.created) == (one.taken, one.given, one.created)


@pytest.mark.parametrize("rollback", [False, True])
def test_effects_of_zero_size_change_no_step_that_power_chooses(rollback):
    master = {"name": "adaptive", "tolerance": "1 mJ", "estimate": "power", "rollback": rollback}
    plain, books = simulated(oscillator(), master, 20)
    other, others = simulated(through({"delay": "0 s"}, {"quantise": "0 N"}), master, 20)
    fixed, _ = simulated(oscillator(), "gauss-seidel", 20)
    assert other["mass.position"].tolist() == plain["mass.position"].tolist()
    assert other["mass.position"].tolist() != fixed["mass.position"].tolist()
    assert created(others) == created(books)


@pytest.mark.parametrize("on", ["position", "force"])
@pytest.mark.parametrize("effect", [{"gain": 1.1}, {"delay": "0.1 s"}, {"low-pass": "2 Hz"}], ids=str)
@pytest.mark.parametrize("name", ["jacobi", {"name": "iterative", "tolerance": 1e-12}], ids=str)
def test_what_effects_do_is_not_what_the_coupling_does(name, effect, on):
    """The coupling's own share vanishes with the step size, that of the effect stays."""
    found = []
    for steps in (200, 400):
        results, ledger = simulated(through(effect, on=on), name, steps)
        (account,) = ledger.accounts().values()
        velocity = results["mass.velocity"]
        assert account.taken == pytest.approx(0.5 * velocity[-1] ** 2, rel=1e-9), (
            "all energy comes by the bond"
        )
        found.append((account.created, account.taken - account.given - account.created))
    (created, between), (halved, still) = found
    assert abs(created) > 1e-4
    assert halved == pytest.approx(created / 2.0, rel=0.1)
    assert abs(still) > 0.02 and still == pytest.approx(between, rel=0.1)


def test_a_sum_of_forces_is_no_bond():
    def summed(bonds=None):
        springs = [Part("spring", spring()), Part("other", spring())]
        return assemble(
            [Part("mass", mass(), {"position": "1 m"}), *springs],
            [
                "mass.position -> spring.position",
                "mass.position -> other.position",
                {"from": ["spring.force", "other.force"], "to": "mass.force"},
            ],
            bonds=bonds,
        )

    system = summed()
    assert system.bonds == ()
    assert system.notes[-1] == (
        "no books are kept of power bonds spring-mass: one of their connections is made of several signals"
    )
    bond = BondModel(effort="spring.force -> mass.force", flow="mass.position -> spring.position")
    with pytest.raises(ConfigError) as caught:
        summed([bond])
    assert str(caught.value).splitlines()[0] == (
        "system: bonds[0]: spring.force + other.force -> mass.force is made of several signals, "
        "whose energies cannot be distinguished"
    )


def test_a_declared_bond_is_named_without_its_effects():
    overrides = ["connections[sensor.force].through=[{delay: 1 ms}]", "run.stop_time=1 ms"]
    (bond,) = prepare("docking-1d", overrides).system.bonds
    assert str(bond.effort[0]) == "contact.force -> delay -> sensor.force"


# The docking loop.


def docking(master, step, *overrides):
    overrides = [f"run.master={master}", f"run.step_size={step}", "run.stop_time=0.5 s", *overrides]
    prepared = prepare("docking-1d-uncompensated", ["satellite.form=native", *overrides])
    recorder, ledger = Recorder(prepared.system), Ledger(prepared.system)
    simulate(prepared.system, prepared.master, prepared.grid, [recorder], loop="python", ledger=ledger)
    velocity = recorder.results()["satellite.velocity"]
    gained = 0.5 * 279.06976744186045 * (velocity[-1] ** 2 - velocity[0] ** 2)
    return ledger.accounts()["contact-satellite"], gained, float(velocity[-1])


def test_around_the_docking_loop_jacobi_creates_what_its_two_steps_of_delay_say():
    """A hold is late by half a step, passing through the contact by another whole one: 1 + 1/2 + 1/2."""
    account, gained, velocity = docking("jacobi", "0.25 ms")
    sound, gained_soundly, _ = docking("gauss-seidel", "0.25 ms")
    force, command, position = account.parts.values()
    assert force == pytest.approx(2.0 * command, rel=0.02) and position == pytest.approx(command, rel=0.02)
    assert account.taken == pytest.approx(gained, rel=1e-9), "all that the satellite gains comes by the bond"
    assert abs(account.given) < 1e-4 * account.exchanged, "the contact returns all that it took"
    # What is created early in the contact grows by the rig's own injection in the rest of it: of the whole
    # surplus the ledger has the share (1 + g^2)/2/g^2, g being the growth per contact.
    growth = (velocity / 0.02) ** 2
    share = (1.0 + growth) / 2.0 / growth
    assert account.created == pytest.approx(share * (gained - gained_soundly), rel=0.03)
    # Under Gauss-Seidel's order the early hold of the motion cancels the late one of the force.
    assert abs(sound.created) < 1e-4 * sound.exchanged
    assert sound.parts["contact.force -> satellite.force"] > 100 * abs(sound.created)


@pytest.mark.skipif(find_spec("numba") is None, reason="the native loop needs numba")
@pytest.mark.parametrize("master", ["jacobi", "gauss-seidel"])
@pytest.mark.parametrize("every", [1, 7])
@pytest.mark.parametrize("effects", ["", "[{delay: 1 ms}, {gain: 0.99}]"], ids=["plain", "effects"])
def test_both_loops_keep_the_same_books(master, every, effects):
    overrides = [f"connections[satellite.force].through={effects}"] if effects else []
    overrides += [f"run.master={master}", "run.step_size=0.1 ms", "run.stop_time=0.6 s"]
    prepared = prepare("docking-1d-uncompensated", ["satellite.form=native", *overrides])
    courses = []
    for loop in ("python", "native"):
        ledger = Ledger(prepared.system, every=every)
        simulate(prepared.system, prepared.master, prepared.grid, loop=loop, ledger=ledger)
        courses.append((*ledger.energies_over_time(), ledger.accounts()["contact-satellite"]))
    (times, one, account), (other_times, other, other_account) = courses
    assert times.tolist() == other_times.tolist()
    assert one["contact-satellite"] == pytest.approx(other["contact-satellite"], abs=1e-14)
    assert account.created == pytest.approx(other_account.created, abs=1e-14)
    assert len(times) == 6000 // every + 1


def test_summary_file_and_terminal_tell(tmp_path, capsys):
    arguments = ["docking-1d-uncompensated", "--out", str(tmp_path), "--set", "run.master=jacobi"]
    arguments += ["--set", "run.step_size=1 ms", "--set", "run.stop_time=0.5 s"]
    assert main(["run", *arguments]) == 0
    printed = capsys.readouterr().out
    assert (
        "The coupling created 0.0118 J at contact-satellite, 7.61% of what it exchanged, 3.84% at half"
        in printed
    )
    summary = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    reported = summary["coupling"]["contact-satellite"]
    assert reported["relative"] == reported["created"] / reported["exchanged"]
    assert reported["between"] == pytest.approx(reported["taken"] - reported["given"] - reported["created"])
    change = summary["numerics"]["coupling"]["contact-satellite"]["created"]
    assert (reported["created"] + change) / reported["created"] == pytest.approx(0.5, abs=0.03)
    with (tmp_path / "coupling.csv").open(encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["time [s]", *(f"contact-satellite.{one} [J]" for one in ("taken", "given", "created"))]
    assert float(rows[-1][3]) == reported["created"] and len(rows) == 502
    assert (tmp_path / "coupling.png").stat().st_size > 10_000


def test_a_sound_coupling_is_not_spoken_of():
    from orchestrator.base.text_tables import summary_text

    overrides = ["run.stop_time=0.5 s", "run.step_size=1 ms"]
    result = run("docking-1d-uncompensated", overrides=overrides, halving=False)
    assert abs(result.summary["coupling"]["contact-satellite"]["relative"]) < 1e-3
    assert "The coupling" not in summary_text(result.summary)


def test_a_system_without_bonds_has_no_ledger():
    system = assemble([Part("one", gain(), {"u": 1})])
    assert not Ledger(system)
    results, ledger = simulated(system, "jacobi", 4)
    assert len(results) == 5 and ledger.accounts() == {}


def test_how_a_run_is_cut_into_blocks_changes_no_digit(monkeypatch):
    """Native chunks end by the clock, so that equal runs are cut differently."""
    reported = []
    for numbers in (1 << 16, 1 << 10):
        monkeypatch.setattr(native_loop, "_NUMBERS", numbers)
        reported.append(run("docking-1d", overrides=["run.stop_time=0.4 s"]).summary["coupling"])
    assert reported[0] == reported[1] and any(one["exchanged"] > 0.0 for one in reported[0].values())
