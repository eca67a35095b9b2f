"""The stiffness is another than calibrated."""

from __future__ import annotations

from ..effect import Effect, Parameter

EFFECT = Effect(
    id="contact.stiffness",
    equation="k = k_0 (1 + r)",
    source="Eq. 20 of the docking source",
    parameters=(Parameter("relative", "1", 0.2, low=-0.9, high=5.0),),
    changes={"*contact_stiffness": "relative"},
)
