"""Stability of delayed loops in the frequency domain, from the co-simulation's own parameters.

Imports `exchange` and the packages below it.
"""

from .charts import Chart, chart
from .disk import DiskMargin, disk_margin
from .excite import sweep_system
from .gain import Contact, contact_root, growth_per_contact, predict_contact
from .linearise import direct_gains, sweep
from .loop import Loop
from .margins import CriticalDelay, Crossover, Margins, critical_delays, margins
from .points import source_points
from .quasi import QuasiPolynomial, characteristic
from .roots import Roots, count_right_of, rightmost_roots
from .sampled import SampledLoop, sample
from .sampled_system import SampledSystem, sampled_system
from .statespace import StateSpace, state_space, system_state_space
from .stepped import sampled_chart
from .tones import Measured
from .transfer import Transfer
from .trim import Trimmed, trim

__all__ = [
    "Chart",
    "Contact",
    "CriticalDelay",
    "Crossover",
    "DiskMargin",
    "Loop",
    "Margins",
    "Measured",
    "QuasiPolynomial",
    "Roots",
    "SampledLoop",
    "SampledSystem",
    "StateSpace",
    "Transfer",
    "Trimmed",
    "characteristic",
    "chart",
    "contact_root",
    "count_right_of",
    "critical_delays",
    "direct_gains",
    "disk_margin",
    "growth_per_contact",
    "margins",
    "predict_contact",
    "rightmost_roots",
    "sample",
    "sampled_chart",
    "sampled_system",
    "source_points",
    "state_space",
    "sweep",
    "sweep_system",
    "system_state_space",
    "trim",
]
