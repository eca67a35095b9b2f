"""The front frame is not where it should be."""

from __future__ import annotations

from ..effect import Effect, Parameter

EFFECT = Effect(
    id="contact.wall-offset",
    equation="x_front = x_0 + o",
    source="Geometry",
    parameters=(Parameter("offset", "m", 0.0002, low=-0.005, high=0.005),),
    changes={"front_wall": "offset"},
)
