"""Make the picture of the README: `python docs/pictures/make.py`."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

import orchestrator as orc

RUNS = {"docking-1d-uncompensated": "without compensation", "docking-1d": "with active compliance control"}


def main() -> None:
    """Run both systems, and draw velocity and contact force of each, side by side."""
    figure = Figure(figsize=(9.0, 4.2), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True, sharey="row")
    for column, (name, title) in enumerate(RUNS.items()):
        result = orc.run(name, set={"robot.tau_m": "6 ms", "run.stop_time": "3 s"}, halving=False)
        velocity, force = result["satellite.velocity"], result["contact.force"]
        axes[0, column].plot(velocity.time, 1e3 * velocity, color="#0072B2")
        axes[1, column].plot(force.time, force, color="#D55E00")
        axes[0, column].set_title(title)
        axes[1, column].set_xlabel("time [s]")
    axes[0, 0].set_ylabel("velocity [mm/s]")
    axes[1, 0].set_ylabel("contact force [N]")
    for one in axes.flat:
        one.grid(alpha=0.3)
    figure.savefig(Path(__file__).with_name("contact.png"), dpi=90)


if __name__ == "__main__":
    main()
