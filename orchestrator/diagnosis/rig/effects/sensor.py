"""Effects of the force sensor."""

from __future__ import annotations

import math

from ..config_changes import FORCE, READING, SEED, TOOL, ConfigChanges, through, with_unit
from ..effect import Context, Effect, Parameter, Site, law

_ACCELERATION = int(Context.ACCELERATION)

_COLOURED_NOISE_KEEP = 0.9  # of the noise per tick; statistics estimate its deviation only


def _coloured_noise_written(t, rig) -> ConfigChanges:
    correlation = -rig["tick"] / math.log(_COLOURED_NOISE_KEEP)
    return through(
        READING,
        noise=with_unit(t["deviation"], "N"),
        period=with_unit(rig["tick"], "s"),
        correlation=with_unit(correlation, "s"),
        seed=SEED,
    )


@law
def _drift(time, step, value, context, memory, theta):
    return value + theta[0] * time


@law
def _gain(time, step, value, context, memory, theta):
    return (1.0 + theta[0]) * value


@law
def _low_pass(time, step, value, context, memory, theta):
    if theta[0] <= 0.0:
        return value
    keep = math.exp(-step / theta[0])
    out = keep * memory[0] + (1.0 - keep) * 0.5 * (value + memory[1])
    memory[0], memory[1] = out, value
    return out


@law
def _tool_inertia(time, step, value, context, memory, theta):
    return value - theta[0] * context[_ACCELERATION]


EFFECTS = (
    Effect(
        id="sensor.bias",
        words="A constant error",
        equation="F_m = F + b",
        source="ISO/IEC Guide 98-3 (GUM)",
        parameters=(Parameter("bias", "N", 1.5, low=-50.0, high=50.0),),
        changes={"force_bias": "bias"},
    ),
    Effect(
        id="sensor.coloured-noise",
        words="Noise with memory",
        equation="F_m = F + n, n first-order autoregressive",
        source="Box, Jenkins: Time Series Analysis, ch. 3",
        parameters=(Parameter("deviation", "N", 2.0, low=0.0),),
        statistic="coloured-noise",
        written=_coloured_noise_written,
    ),
    Effect(
        id="sensor.delay",
        words="The measurement has more pure delay than calibrated",
        equation="F_m(t) = F(t - tau_s - d)",
        source="Eq. 25 of the docking source",
        parameters=(Parameter("delay", "s", 0.0005, low=-0.001, high=0.01),),
        changes={"sensor_delay": "delay"},
    ),
    Effect(
        id="sensor.drift",
        words="An error that grows with time",
        equation="F_m = F + d t",
        source="ISO/IEC Guide 98-3 (GUM)",
        parameters=(Parameter("rate", "N/s", 0.5, low=-20.0, high=20.0),),
        site=Site.SAMPLE,
        apply=_drift,
        written=lambda t, rig: through(READING, drift=with_unit(t["rate"], "N/s")),
    ),
    Effect(
        id="sensor.dropout",
        words="Samples are lost with a probability; the last one holds",
        equation="F_m[n] = F_m[n-1] with probability p",
        source="Gilbert: Capacity of a burst-noise channel, memoryless case",
        parameters=(Parameter("probability", "1", 0.15, low=0.0, high=1.0),),
        statistic="dropout",
        written=lambda t, rig: through(
            READING, dropout=t["probability"], period=with_unit(rig["tick"], "s"), seed=SEED
        ),
    ),
    Effect(
        id="sensor.gain",
        words="A proportional error",
        equation="F_m = (1 + g) F",
        source="ISO/IEC Guide 98-3 (GUM)",
        parameters=(Parameter("gain", "1", 0.1, low=-0.9, high=3.0),),
        site=Site.SAMPLE,
        apply=_gain,
        written=lambda t, rig: through(READING, gain=1.0 + t["gain"]),
    ),
    Effect(
        id="sensor.low-pass",
        words="A further first-order filter",
        equation="T F_m' + F_m = F",
        source="Oppenheim, Willsky: Signals and Systems, ch. 6",
        parameters=(Parameter("time_constant", "s", 0.001, low=0.0, high=0.02, starts=(0.0003, 0.0015)),),
        site=Site.FORCE,
        apply=_low_pass,
        memory=2,
        written=lambda t, rig: through(FORCE, low_pass={"time_constant": with_unit(t["time_constant"], "s")}),
    ),
    Effect(
        id="sensor.quantisation",
        words="A coarser resolution than specified",
        equation="F_m = q round(F/q)",
        source="Widrow, Kollar: Quantization Noise, 2008",
        parameters=(Parameter("step", "N", 1.0, low=0.2, high=20.0),),
        statistic="quantisation",
        written=lambda t, rig: through(READING, quantise=with_unit(t["step"], "N")),
    ),
    Effect(
        id="sensor.tool-inertia",
        words="The tool in front of the sensor adds its inertia force",
        equation="F_m = F - m x''",
        source="Kubus, Kroger, Wahl: On-line estimation of inertial parameters, IROS 2008",
        parameters=(Parameter("mass", "kg", 5.0, low=-50.0, high=50.0),),
        site=Site.FORCE,
        apply=_tool_inertia,
        # The robot, too: the tool feels a first command that does not continue the motion before the start.
        written=lambda t, rig: ConfigChanges(
            start={"sensor": {"tool_mass": with_unit(t["mass"], "kg")}, "robot": {}}, adds=(TOOL,)
        ),
    ),
)
