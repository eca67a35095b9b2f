"""The operating points of the source, where they lie in a chart.

He, Shen, Gao, Zhang, "Active Compliance Control of a Position-Controlled Industrial Robot for Simulating
Space Operations", Sections 2.4, 4.1 and 4.2. What it does not print is not in a point.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .charts import Chart

__all__ = ["SOURCE_POINTS", "source_points"]

_MASS = {("SatelliteDynamics", "mass"): 300.0 * 4000.0 / 4300.0}
_ROBOT = {("RobotResponse", "omega_n"): 2.0 * np.pi * 75.0, ("RobotResponse", "xi_n"): 0.8}
_CONTACT = {("DockingContact", "stiffness"): 176e3, ("DockingContact", "damping"): 0.0}

# Values, SI, by model and parameter.
SOURCE_POINTS: Mapping[str, Mapping[tuple[str, str], float]] = {
    "source, 2 ms": {**_MASS, **_ROBOT, **_CONTACT, ("RobotResponse", "tau_m"): 2e-3},
    "source, 6 ms": {**_MASS, **_ROBOT, **_CONTACT, ("RobotResponse", "tau_m"): 6e-3},
    "source, 70 N/mm": {
        **_MASS,
        ("DockingContact", "stiffness"): 70e3,
        ("DockingContact", "damping"): 100.0,
    },
}


def source_points(chart: Chart) -> dict[str, tuple[float, float]]:
    """The source's points that lie in a chart's plane: x and y, SI, by name.

    A point lies there if it says both coordinates and, of the parameters that are not on an axis, agrees with
    the chart's loop to a part in a thousand in all that it says.
    """
    loop, found = chart.loop, {}
    for name, values in SOURCE_POINTS.items():
        point = {f"{loop.only(model)}.{key}": value for (model, key), value in values.items()}
        if chart.x_name not in point or chart.y_name not in point:
            continue
        x, y = point.pop(chart.x_name), point.pop(chart.y_name)
        within = chart.x[0] <= x <= chart.x[-1] and chart.y[0] <= y <= chart.y[-1]
        if within and all(np.isclose(loop.parameters[key], value, 1e-3) for key, value in point.items()):
            found[name] = x, y
    return found
