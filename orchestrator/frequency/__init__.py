"""Stability of configured systems with delays, from the config that the co-simulation runs.

Imports `exchange` and the packages listed before it in CONTRIBUTING.md.
"""

from .chart import chart_of, config_chart
from .chart_report import Chart, chart_figure
from .delay_equation import Link
from .delay_system import DelaySystem
from .describing import LimitCycle, describing_function, limit_cycles
from .disk import DiskMargin, disk_margin
from .excite import sweep_system
from .from_system import Law, Linearised, LinearPoint, linearise
from .margins import Crossover, Margins
from .measured_response import sweep
from .modes import Mode, Modes
from .open_loop import OpenLoop
from .over_parameter import parameter_range
from .sampled_system import SampledSystem, sampled_system
from .statespace import StateSpace
from .tones import Measured
from .trim import Trimmed, trim

__all__ = [
    "Chart",
    "Crossover",
    "DelaySystem",
    "DiskMargin",
    "Law",
    "LimitCycle",
    "LinearPoint",
    "Linearised",
    "Link",
    "Margins",
    "Measured",
    "Mode",
    "Modes",
    "OpenLoop",
    "SampledSystem",
    "StateSpace",
    "Trimmed",
    "chart_figure",
    "chart_of",
    "config_chart",
    "describing_function",
    "disk_margin",
    "limit_cycles",
    "linearise",
    "parameter_range",
    "sampled_system",
    "sweep",
    "sweep_system",
    "trim",
]
