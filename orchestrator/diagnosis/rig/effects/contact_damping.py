"""The damping is another than calibrated."""

from __future__ import annotations

from ..effect import Effect, Parameter

EFFECT = Effect(
    id="contact.damping",
    equation="c = c_0 + d",
    source="Eq. 20 of the docking source",
    parameters=(Parameter("damping", "N.s/m", 100.0, low=-500.0, high=5000.0),),
    changes={"contact_damping": "damping"},
)
