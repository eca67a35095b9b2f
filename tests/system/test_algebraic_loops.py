"""Loops of direct feedthrough are reported, with the way out of each; and in what order a system runs."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest
import yaml
from assembled import assemble, refusal
from doubles import FakeFmu, gain, mass, spring

from orchestrator.base.errors import ConfigError
from orchestrator.config import Places
from orchestrator.master import create_master
from orchestrator.system.assembly import Part


def test_an_algebraic_loop_is_reported_hop_by_hop():
    parts = [Part("a", gain(feedthrough=None)), Part("b", gain())]
    assert refusal(parts, ["a.y -> b.u", "b.y -> a.u"]).splitlines() == [
        "docking.yaml: connections: algebraic loop",
        "  b.u is direct-feedthrough to b.y",
        "  b.y is connected to a.u",
        "  a.u is direct-feedthrough to a.y (assumed: the FMU does not say what it depends on)",
        "  a.y is connected to b.u",
        "  The master iterative solves it; or take a connection out of the loop, or put an instance without "
        "direct feedthrough into it.",
        "  If a.y does not depend on the inputs of the same instant, say so: "
        "instances.a.feedthrough: {y: []}",
    ]


def test_a_loop_that_is_only_assumed_is_a_note():
    parts = [Part("a", gain(feedthrough=None)), Part("b", gain(feedthrough=None))]
    loop = ["a.y -> b.u", "b.y -> a.u"]
    system = assemble(parts, loop, places=Places("docking.yaml"))
    assert system.notes == (
        "docking.yaml: connections: an algebraic loop that is only assumed: the FMUs do not say what a.y, "
        "b.y depend on. Its inputs hold their values over a step, one step of delay (under gauss-seidel only "
        "those from instances that step later); at the start, begun with start values, they are passed on "
        "until they agree. If the outputs do not depend on inputs of the same instant, say so: "
        "instances.a.feedthrough: {y: []}; instances.b.feedthrough: {y: []}. "
        "If they do, take the master iterative.",
    )
    assert system.loops == () and create_master("jacobi").check(system) == []
    # A master that solves loops solves this one.
    solved = assemble(parts, loop, loops=True)
    assert len(solved.loops) == 1 and not solved.notes and not solved.held
    # What the config says is declared: of no dependency, and of all.
    free = [parts[0], replace(parts[1], feedthrough={"y": []})]
    assert assemble(free, loop).notes == ()
    for stated in ([replace(one, feedthrough={"y": ["u"]}) for one in parts], [parts[0], Part("b", gain())]):
        assert "connections: algebraic loop\n" in refusal(stated, loop)


def test_what_a_loop_asks_to_be_said_can_be_pasted():
    bus = FakeFmu(inputs={"u[1]": "", "u[2]": ""}, outputs={"y[1]": "", "y[2]": ""}, feedthrough=None)
    parts = [Part("a", bus), Part("b", bus)]
    (note,) = assemble(parts, ["a.y -> b.u", "b.y -> a.u"]).notes
    pasted = re.search(r"instances\.a\.feedthrough: (\{.*?\})", note)[1]
    assert yaml.safe_load(pasted) == {"y[1]": [], "y[2]": []}


def test_a_declared_loop_among_assumed_ones_is_the_one_that_is_reported():
    hub = FakeFmu(name="Hub", inputs={"u": "", "v": ""}, outputs={"y": ""}, feedthrough=None)
    parts = [Part("hub", hub), Part("a", gain(feedthrough=None)), Part("b", gain())]
    text = refusal(parts, ["hub.y -> a.u", "a.y -> hub.u", "hub.y -> b.u", "b.y -> hub.v"])
    assert "b.u is direct-feedthrough to b.y\n" in text and "a.u" not in text


def test_an_algebraic_loop_tells_effects_and_delays_that_are_too_short():
    parts = [Part("a", gain()), Part("b", gain())]

    def reported(step_size, delay="1 ms"):
        through = [{"gain": 2}, {"delay": delay}]
        connections = ["a.y -> b.u", {"from": "b.y", "to": "a.u", "through": through}]
        with pytest.raises(ConfigError) as caught:
            assemble(parts, connections, step_size=step_size)
        return str(caught.value).splitlines()[1:]

    plain = "  b.y is connected to a.u through gain, delay"
    remedy = "  A delay that is no shorter than the step breaks the loop."
    short = reported(5e-3)
    assert f"{plain} (shorter than the step of 0.005 s, hence passed at once)" in short
    assert short[-2] == remedy
    for lines in (reported(None), reported(5e-3, "0 s")):
        assert plain in lines and remedy not in lines
    # A delay of a step breaks the loop at communication points.
    assemble(
        parts, ["a.y -> b.u", {"from": "b.y", "to": "a.u", "through": [{"delay": "1 ms"}]}], step_size=1e-3
    )


def test_a_stated_feedthrough_opens_the_loop():
    parts = [Part("a", gain(feedthrough=None), feedthrough={"y": []}), Part("b", gain())]
    assert assemble(parts, ["a.y -> b.u", "b.y -> a.u"]).order == (0, 1)
    wrong = [Part("a", gain(), {"u": 1}, feedthrough={"z": [], "y": ["v"]})]
    assert refusal(wrong).splitlines() == [
        "docking.yaml: instances.a.feedthrough.z: a has no output 'z'",
        "  outputs: y",
        "docking.yaml: instances.a.feedthrough.y: a has no input 'v'",
        "  inputs: u",
    ]


def test_an_instance_fed_by_itself_is_a_loop():
    assert "b.u is direct-feedthrough to b.y\n  b.y is connected to b.u" in refusal(
        [Part("b", gain())], ["b.y -> b.u"]
    )


def test_order_follows_feedthrough_and_the_config_breaks_ties():
    #   mass -> spring -> gain -> other mass;  declared backwards
    parts = [
        Part("last", gain(unit_in="N", unit_out="N")),
        Part("middle", spring()),
        Part("mass", mass()),
        Part("other", mass()),
    ]
    system = assemble(
        parts,
        ["mass.position -> middle.position", "middle.force -> last.u", "last.y -> other.force",
         "last.y -> mass.force"],
    )  # fmt: skip
    assert [system.instances[index].name for index in system.order] == ["mass", "middle", "last", "other"]
    assert [[str(c) for c in level] for level in system.initial_levels] == [
        ["mass.position -> middle.position"],
        ["middle.force -> last.u"],
        ["last.y -> other.force", "last.y -> mass.force"],
    ]
