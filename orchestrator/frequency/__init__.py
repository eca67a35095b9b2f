"""Stability of delayed loops in the frequency domain, from the co-simulation's own parameters."""

from .charts import Chart, chart
from .gain import Contact, contact_root, growth_per_contact, predict_contact
from .linearise import Measured, direct_gains, sweep
from .loop import Loop
from .margins import CriticalDelay, Crossover, Margins, critical_delays, margins
from .quasi import QuasiPolynomial, characteristic
from .roots import Roots, count_right_of, rightmost_roots
from .sampled import SampledLoop, sample
from .transfer import Transfer

__all__ = [
    "Chart",
    "Contact",
    "CriticalDelay",
    "Crossover",
    "Loop",
    "Margins",
    "Measured",
    "QuasiPolynomial",
    "Roots",
    "SampledLoop",
    "Transfer",
    "characteristic",
    "chart",
    "contact_root",
    "count_right_of",
    "critical_delays",
    "direct_gains",
    "growth_per_contact",
    "margins",
    "predict_contact",
    "rightmost_roots",
    "sample",
    "sweep",
]
