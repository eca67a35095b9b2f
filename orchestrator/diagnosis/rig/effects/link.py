"""Effects of the link that carries commands."""

from __future__ import annotations

from ..config_changes import COMMAND, ConfigChanges, held, start, through, with_unit
from ..effect import Effect, Parameter, Site, law


@law
def _clock_skew(time, step, value, context, memory, theta):
    return max(value + theta[0] * time, 0.0)


@law
def _jitter(time, step, value, context, memory, theta):
    return value + 0.5 * theta[0]  # the mean


@law
def _packet_loss(time, step, value, context, memory, theta):
    # What arrives in the mean: each command lost leaves the one before.
    if memory[1] == 0.0:
        memory[0], memory[1] = value, 1.0
    memory[0] = theta[0] * memory[0] + (1.0 - theta[0]) * value
    return memory[0]


@law
def _sample_and_hold(time, step, value, context, memory, theta):
    every = round(theta[0])
    tick = round(time / step)
    if memory[1] == 0.0 or (tick + 1) % every == 0:
        memory[0] = value
        memory[1] = 1.0
    return memory[0]


def _sample_and_hold_written(t, rig) -> ConfigChanges:
    # A command is there from the end of its tick's first step on.
    period = round(t["every"]) * rig["tick"]
    phase = period - rig["tick"] + rig["step"]
    return through(COMMAND, sample_and_hold=with_unit(period, "s"), phase=with_unit(phase, "s"))


EFFECTS = (
    Effect(
        id="link.clock-skew",
        words="The clock of the link drifts: the delay grows with time",
        equation="tau(t) = tau_m + s*t",
        source="Mills: RFC 5905, skew of clocks",
        parameters=(Parameter("skew", "1", 0.0003, low=-0.005, high=0.005, starts=(0.0001, -0.0001)),),
        site=Site.DELAY,
        apply=_clock_skew,
        written=lambda t, rig: start("robot", skew=(t["skew"], "1")),
    ),
    Effect(
        id="link.jitter",
        words="Each command is delayed by a random time more",
        equation="tau[n] = tau_m + U(0, J)",
        source="Nilsson: Real-Time Control Systems with Delays, 1998",
        parameters=(Parameter("jitter", "s", 0.001, low=0.0, high=0.01),),
        site=Site.DELAY,
        apply=_jitter,
        statistic="jitter",
        written=lambda t, rig: held("jitter", with_unit(t["jitter"], "s"), rig),
    ),
    Effect(
        id="link.packet-loss",
        words="A command is lost with a probability; the last one holds",
        equation="c[n] = c[n-1] with probability p",
        source="Gilbert: Capacity of a burst-noise channel, memoryless case",
        parameters=(Parameter("probability", "1", 0.1, low=0.0, high=0.95),),
        site=Site.COMMAND,
        apply=_packet_loss,
        memory=2,
        statistic="packet-loss",
        written=lambda t, rig: held("dropout", t["probability"], rig),
    ),
    Effect(
        id="link.sample-and-hold",
        words="The command link passes every n-th command only",
        equation="c[n] = command[N*floor((n + 1)/N) - 1]",
        source="Astrom, Wittenmark: Computer-Controlled Systems, ch. 1",
        parameters=(Parameter("every", "1", 1.0, low=2.0, high=12.0, whole=True),),
        site=Site.COMMAND,
        apply=_sample_and_hold,
        memory=2,
        written=_sample_and_hold_written,
    ),
)
