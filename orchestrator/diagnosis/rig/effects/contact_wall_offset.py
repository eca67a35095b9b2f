"""The front frame is not where it should be."""

from __future__ import annotations

from ..effect import Effect, Parameter

# Between these the depth of contacts, and with it the force, hardly says which way to go.
_STARTS = (1e-5, -1e-5, 1e-4, -1e-4, 3e-4, -3e-4)

EFFECT = Effect(
    id="contact.wall-offset",
    equation="x_front = x_0 + o",
    source="Geometry",
    parameters=(Parameter("offset", "m", 0.0002, low=-0.005, high=0.005, starts=_STARTS),),
    changes={"front_wall": "offset"},
)
