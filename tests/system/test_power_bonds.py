"""Power bonds: which are found, and which are declared."""

from __future__ import annotations

import pytest
from assembled import assemble
from coupled import PERIOD, simulated
from doubles import FakeFmu, gain, mass

from orchestrator.base.errors import ConfigError
from orchestrator.config import BondModel
from orchestrator.simulation.run import prepare
from orchestrator.system.assembly import Part

# Which bonds are found.


def test_a_chain_through_a_robot_is_one_bond():
    system = prepare("docking-1d-uncompensated").system
    assert [str(bond) for bond in system.bonds] == [
        "contact-satellite: contact.force -> satellite.force, satellite.position -> robot.command, "
        "robot.position -> contact.position (not the rate: robot.velocity -> contact.velocity)"
    ]
    # What is declared passes over nothing.
    (declared,) = prepare("docking-1d").system.bonds
    assert str(declared).endswith(", satellite.position -> robot.command, robot.position -> contact.position")


def both_reported(**changes):
    """A mass whose spring is reported position and velocity."""
    damped = FakeFmu(
        inputs={"position": "m", "velocity": "m/s"},
        outputs={"force": "N"},
        feedthrough={"force": ["position", "velocity"]},
        output=lambda v: {"force": -v["position"] - 0.1 * v["velocity"]},
    )
    connections = ["mass.velocity -> damped.velocity", "mass.position -> damped.position"]
    return assemble(
        [Part("mass", mass(), {"position": "1 m"}), Part("damped", damped)],
        [*connections, "damped.force -> mass.force"],
        **changes,
    )


def test_of_a_flow_and_its_displacement_the_displacement_counts_and_the_other_is_reported():
    (bond,) = both_reported().bonds
    assert str(bond) == (
        "damped-mass: damped.force -> mass.force, mass.position -> damped.position "
        "(not the rate: mass.velocity -> damped.velocity)"
    )
    assert [str(leg) for leg in bond.flow] == ["mass.position -> damped.position"]
    assert bond.displaced == (True, True)


def test_overlapping_bonds_are_left_to_the_author():
    twice = FakeFmu(inputs={"x": "m"}, outputs={"f": "N", "g": "N"})
    body = FakeFmu(inputs={"f": "N", "g": "N"}, outputs={"x": "m"})
    system = assemble(
        [Part("twice", twice), Part("body", body)],
        ["body.x -> twice.x", "twice.f -> body.f", "twice.g -> body.g"],
    )
    assert system.bonds == ()
    assert system.notes == ("power bonds twice-body overlap: say under bonds which connections carry energy",)


def test_elements_of_arrays_are_matched_by_their_subscripts():
    axes = [f"[{n}]" for n in (1, 2, 3)]
    body = FakeFmu(inputs={f"f{n}": "N" for n in axes}, outputs={f"v{n}": "m/s" for n in axes})
    pad = FakeFmu(inputs={f"v{n}": "m/s" for n in axes}, outputs={f"f{n}": "N" for n in axes})
    connections = [f"pad.f{n} -> body.f{n}" for n in axes] + [f"body.v{n} -> pad.v{n}" for n in axes]
    system = assemble([Part("body", body), Part("pad", pad)], connections)
    assert [bond.name for bond in system.bonds] == ["pad-body", "pad-body-2", "pad-body-3"]


def test_where_one_way_is_in_doubt_the_others_between_the_same_two_are():
    """A torque beside a force that may come by a sensor: half of an account is none."""
    motion = {"v": "m/s", "w": "rad/s"}
    body = FakeFmu(inputs={"f": "N", "t": "N.m"}, outputs=motion)
    law = FakeFmu(inputs={"measured": "N", **motion}, outputs={"f": "N", "t": "N.m"})
    sensor = FakeFmu(inputs={"v": "m/s"}, outputs={"f": "N"})
    system = assemble(
        [Part("body", body), Part("law", law), Part("sensor", sensor)],
        [
            "sensor.f -> law.measured",
            "law.f -> body.f",
            "law.t -> body.t",
            "body.v -> sensor.v",
            "body.v -> law.v",
            "body.w -> law.w",
        ],
    )
    assert system.bonds == ()
    assert system.notes == (
        "power bonds sensor-body, law-body overlap: say under bonds which connections carry energy",
    )


@pytest.mark.parametrize(
    ("effort", "motion", "displaced"),
    [("N.m", "rad/s", False), ("N.m", "rad", True), ("kPa", "l/min", False), ("mV", "A", False)],
)
def test_domains(effort, motion, displaced):
    giver = FakeFmu(inputs={"m": motion}, outputs={"e": effort})
    taker = FakeFmu(inputs={"e": effort}, outputs={"m": motion})
    system = assemble(
        [Part("giver", giver), Part("taker", taker)], ["giver.e -> taker.e", "taker.m -> giver.m"]
    )
    assert [bond.displaced for bond in system.bonds] == [(displaced, displaced)]


def test_what_is_no_power_is_no_bond():
    assert (
        assemble(
            [Part("one", gain()), Part("other", gain(feedthrough={}))],
            ["one.y -> other.u", "other.y -> one.u"],
        ).bonds
        == ()
    )


def test_units_other_than_si_are_accounted_in_joules():
    def with_units(length, force, factor_in, factor_out):
        wall = FakeFmu(
            inputs={"position": length},
            outputs={"force": force},
            feedthrough={"force": ["position"]},
            output=lambda v: {"force": -v["position"] * factor_in * factor_out},
        )
        return assemble(
            [Part("mass", mass(), {"position": "1 m"}), Part("wall", wall)],
            ["mass.position -> wall.position", "wall.force -> mass.force"],
        )

    _, plain = simulated(with_units("m", "N", 1.0, 1.0), "jacobi", 50)
    _, other = simulated(with_units("mm", "kN", 1e-3, 1e-3), "jacobi", 50)
    assert other.accounts()["wall-mass"].created == pytest.approx(plain.accounts()["wall-mass"].created)


def test_where_ways_are_too_many_no_bond_is_sought():
    names = [f"i{n}" for n in range(24)]
    fmu = FakeFmu(
        inputs={**{f"f{n}": "N" for n in range(24)}, **{f"x{n}": "m" for n in range(24)}},
        outputs={"f": "N", "x": "m"},
    )
    pairs = [(one, other) for one in range(24) for other in range(24) if one != other]
    connections = [f"{names[a]}.{kind} -> {names[b]}.{kind}{a}" for a, b in pairs for kind in "fx"]
    parts = [
        Part(name, fmu, {f"{kind}{n}": f"0 {unit}" for kind, unit in (("f", "N"), ("x", "m"))})
        for n, name in enumerate(names)
    ]
    system = assemble(parts, connections)
    assert system.bonds == ()
    assert system.notes == (
        "no power bonds are looked for: too many ways between instances; say them under bonds",
    )


# What is declared.


def test_a_declared_bond_by_its_flow_agrees_with_the_one_by_its_displacement():
    declared = [BondModel(effort="damped.force -> mass.force", flow="mass.velocity -> damped.velocity")]
    found = []
    for bonds in (None, declared):
        # Over a period: what stands between the given and the true position at the ends is no difference.
        _, ledger = simulated(both_reported(bonds=bonds), "jacobi", 2000, PERIOD)
        found.append(ledger.accounts()["damped-mass"].created)
    assert found[0] == pytest.approx(found[1], rel=2e-3)


def test_sign_and_port_of_a_declared_bond():
    def made(**values):
        bond = BondModel(effort="damped.force -> mass.force", **values)
        _, ledger = simulated(both_reported(bonds=[bond]), "jacobi", 100, 1)
        return ledger.accounts()["damped-mass"]

    plain = made(flow="mass.position -> damped.position")
    turned = made(flow="mass.position -> damped.position", sign=-1)
    alone = made(flow="mass.velocity")
    assert turned.created == -plain.created and turned.taken == -plain.taken
    assert alone.parts["damped.force -> mass.force"] == pytest.approx(
        plain.parts["damped.force -> mass.force"], rel=0.02
    )
    assert list(alone.parts) == ["damped.force -> mass.force"]


def test_bonds_are_declared_from_the_command_line():
    assert prepare("docking-1d-uncompensated", ["bonds=[]"]).system.bonds == ()
    bond = "{name: tip, effort: contact.force -> satellite.force, flow: satellite.velocity}"
    (found,) = prepare("docking-1d-uncompensated", [f"bonds=[{bond}]"]).system.bonds
    assert str(found) == "tip: contact.force -> satellite.force, satellite.velocity"


def test_wrong_bonds_are_reported_all_at_once():
    bonds = [
        BondModel(effort="damped.forc -> mass.force", flow="mass.velocity -> damped.velocity"),
        BondModel(effort="damped.force -> mass.force", flow="mass.speed"),
        BondModel(effort="mass.position -> damped.position", flow="damped.force -> mass.force"),
        BondModel(effort="mass.velocity -> damped.velocity", flow="mass.position -> damped.position"),
        BondModel(effort="mass.velocity -> damped.velocity", flow="damped.force -> mass.force"),
    ]
    with pytest.raises(ConfigError) as caught:
        both_reported(bonds=bonds)
    reported = str(caught.value).splitlines()
    assert reported == [
        "system: bonds[0]: no connection 'damped.forc -> mass.force'",
        "  Did you mean damped.force -> mass.force?",
        "system: bonds[1]: no output 'mass.speed'",
        "system: bonds[3]: mass.position is no motion of damped, "
        "which mass.velocity -> damped.velocity acts on",
        "  a bond leads from one instance to another and back",
    ]


def test_wrong_bonds_are_reported_with_everything_else():
    """A bond is blamed for its own mistakes only, not for connections and instances that have a problem."""
    connections = ["mass.velocity -> damped.velocity", "mass.position -> damped.position"]
    damped = FakeFmu(inputs={"position": "m", "velocity": "m"}, outputs={"force": "N"})
    bonds = [
        BondModel(effort="damped.force -> mass.force", flow="mass.velocity -> damped.velocity"),
        BondModel(effort="damped.force -> mass.force", flow="gone.velocity"),
        BondModel(effort="damped.force -> gone.force", flow="gone.velocity"),
        BondModel(effort="damped.force -> mass.force", flow="mass.speed"),
        BondModel(effort="damped.forc -> mass.force", flow="mass.position -> damped.position"),
    ]
    with pytest.raises(ConfigError) as caught:
        assemble(
            [Part("mass", mass(), {"position": "1 m", "weight": 3}), Part("damped", damped)],
            [*connections, "damped.force -> mass.force", "damped.force -> gone.force"],
            bonds=bonds,
            absent=frozenset(["gone"]),
        )
    assert [problem.place + ": " + problem.what for problem in caught.value.problems] == [
        "system: connections[0]: cannot connect mass.velocity [m/s] to damped.velocity [m]",
        "system: instances.mass.start.weight: mass has no variable 'weight'",
        "system: bonds[3]: no output 'mass.speed'",
        "system: bonds[4]: no connection 'damped.forc -> mass.force'",
    ]


def test_a_bond_whose_product_is_no_power_is_refused():
    body = FakeFmu(inputs={"f": "N"}, outputs={"a": "m/s2"})
    pad = FakeFmu(inputs={"a": "m/s2"}, outputs={"f": "N"})
    with pytest.raises(ConfigError) as caught:
        assemble(
            [Part("body", body), Part("pad", pad)],
            ["pad.f -> body.f", "body.a -> pad.a"],
            bonds=[BondModel(effort="pad.f -> body.f", flow="body.a -> pad.a")],
        )
    assert "pad.f [N] times body.a [m/s2] is no power\n  W, or J for a displacement, is needed" in str(
        caught.value
    )
