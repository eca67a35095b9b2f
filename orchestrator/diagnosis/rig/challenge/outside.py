"""Kinds of effects outside the catalogue. Nothing that weighs candidates may import this module.

Who made the diagnosis knew of these; of those in `outside_fresh`, not.
"""

from __future__ import annotations

from .outside_contact import CONTACT_KINDS
from .outside_robot import ROBOT_KINDS
from .outside_sensor import SENSOR_KINDS
from .outside_software import SOFTWARE_KINDS

__all__ = ["OUTSIDE"]

OUTSIDE = {one.id: one for one in (*ROBOT_KINDS, *SENSOR_KINDS, *CONTACT_KINDS, *SOFTWARE_KINDS)}
