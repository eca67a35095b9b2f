"""Growth per contact from characteristic roots against co-simulation; stability of random rigs."""

import numpy as np
import pytest

from orchestrator.base.errors import ConfigError
from orchestrator.frequency import (
    Loop,
    chart,
    contact_root,
    growth_per_contact,
    predict_contact,
    rightmost_roots,
    sample,
)
from orchestrator.frequency.charts import unstable_roots
from orchestrator.simulation.run import run

PLAIN = "docking-1d-uncompensated"


def restitutions(name: str, overrides: list[str]) -> list[float]:
    summary = run(name, overrides=[*overrides, "run.stop_time=1.2 s"], halving=False).summary
    return [abs(contact["cor"]) for contact in summary["contacts"]]


@pytest.mark.parametrize(
    "rig", [("75 Hz", "2 ms"), ("75 Hz", "4 ms"), ("75 Hz", "6 ms"), ("25 Hz", "2 ms"), ("100 Hz", "2 ms")]
)
def test_growth_of_the_uncompensated_system(rig):
    overrides = [f"robot.omega_n={rig[0]}", f"robot.tau_m={rig[1]}"]
    loop = Loop.of(PLAIN, overrides)
    root = contact_root(rightmost_roots(loop.characteristic()))
    found = restitutions(PLAIN, overrides)[0]
    assert growth_per_contact(root) == pytest.approx(found, rel=1e-3)
    assert predict_contact(loop).velocity_ratio == pytest.approx(found, rel=1e-5)


def test_damped_contact_ends_before_half_an_oscillation():
    overrides = ["contact.damping=500 N.s/m", "run.step_size=50 us"]
    predicted = predict_contact(Loop.of(PLAIN, overrides))
    assert predicted.velocity_ratio == pytest.approx(np.mean(restitutions(PLAIN, overrides)), rel=1e-4)
    border = Loop.of(PLAIN, ["contact.damping=955.73 N.s/m"])
    assert growth_per_contact(contact_root(rightmost_roots(border.characteristic()))) == pytest.approx(
        1, abs=1e-5
    )
    assert predict_contact(border).velocity_ratio > 1.009


# Estimates that stand still, short samples, early detection: the law of the transfer function.
STILL = [
    "controller.stiffness_sigma=0 N/m",
    "controller.damping_sigma=0 N.s/m",
    "controller.stiffness_spread=0",
    "controller.switching_compensation=false",
    "controller.contact_threshold=0.2 N",
    "controller.release_threshold=0.1 N",
    "controller.sample_period=0.1 ms",
    "run.step_size=0.1 ms",
]


@pytest.mark.parametrize("estimate", [150e3, 176e3, 200e3])
def test_active_controller_with_a_wrong_estimate(estimate):
    overrides = [*STILL, f"controller.initial_stiffness={estimate} N/m"]
    loop = Loop.of("docking-1d", overrides).with_parameters({"controller.stiffness_estimate": estimate})
    predicted = predict_contact(loop).velocity_ratio
    assert predicted == pytest.approx(restitutions("docking-1d", overrides)[0], abs=1e-3)
    error = growth_per_contact(contact_root(rightmost_roots(loop.characteristic()))) - 1
    assert np.sign(round(error, 6)) == np.sign(176e3 - estimate)


@pytest.mark.parametrize(
    ("master", "step", "growth"),
    [
        ("jacobi", 2e-3, 1.44010),
        ("jacobi", 5e-4, 1.28428),
        ("jacobi", 5e-5, 1.24036),
        ("gauss-seidel", 2e-3, 1.23567),
    ],
)
def test_the_step_of_each_master_is_part_of_the_loop(master, step, growth):
    """Growth as docs/masters.md has it from co-simulation."""
    assert sample(Loop.of(PLAIN), master, step).growth() == pytest.approx(growth, rel=2e-4)


@pytest.mark.parametrize(
    ("step", "more"),
    [
        ("2 ms", []),
        ("0.5 ms", ["connections[satellite.force].through=[{delay: 0.33 ms}, {low-pass: 200 Hz}]"]),
    ],
)
def test_the_iterative_master_agrees_with_the_step_s_end(step, more):
    """Every input holds the value of the step's end: early, so that contacts gain less."""
    overrides = [*more, "run.master={name: iterative, tolerance: 1e-9}", f"run.step_size={step}"]
    loop = Loop.of(PLAIN, overrides)
    predicted = sample(loop, "iterative", float(step[:-3]) * 1e-3).growth()
    assert predicted == pytest.approx(restitutions(PLAIN, overrides)[0], rel=2e-4)
    assert predicted < 0.99 * growth_per_contact(contact_root(rightmost_roots(loop.characteristic())))


def test_sampled_loop_with_sensor_and_controller():
    overrides = ["controller.mode=off", "sensor.tau_s=2 ms", "run.step_size=50 us"]
    predicted = sample(Loop.of("docking-1d", overrides), "gauss-seidel", 5e-5).growth()
    assert predicted == pytest.approx(restitutions("docking-1d", overrides)[0], rel=3e-4)


def test_sampled_loop_tends_to_the_continuous_one():
    loop = Loop.of(PLAIN, ["contact.damping=1500 N.s/m", "robot.tau_m=2.3 ms"])
    limit = growth_per_contact(contact_root(rightmost_roots(loop.characteristic())))
    errors = {
        master: [sample(loop, master, step).growth() - limit for step in (4e-4, 2e-4, 1e-4)]
        for master in ("jacobi", "gauss-seidel")
    }
    assert errors["jacobi"][1] / errors["jacobi"][2] == pytest.approx(2.0, rel=0.05)
    # The contact's damping acts on a velocity that is not the step's mean: of first order, too, but small.
    assert abs(errors["gauss-seidel"][2]) < 0.1 * abs(errors["jacobi"][2])


def test_sampled_gain_closes_to_the_same_roots():
    """1 + L(z) = 0 at the closed loop's eigenvalues."""
    loop = sample(Loop.of(PLAIN), "jacobi", 1e-3)
    root = loop.roots()[0]
    z = np.exp(root * loop.period)
    gain = -loop.c @ np.linalg.solve(z * np.eye(len(loop.a)) - loop.a, loop.b)
    assert gain == pytest.approx(-1.0, abs=1e-6)


def test_refusals_of_sampled_loops():
    with pytest.raises(ConfigError) as caught:
        sample(Loop.of(PLAIN), "adaptive", 0.0)
    assert str(caught.value) == (
        f"{PLAIN}: master 'adaptive' is not analysed\n  known: jacobi, gauss-seidel, iterative\n"
        f"{PLAIN}: step size is 0.0 s\n  allowed: finite and positive"
    )


def grows(mass, stiffness, damping, omega_n, xi_n, tau) -> np.ndarray:
    """Whether oscillations in the contact grow, by one co-simulation of all rigs side by side.

    A constant force holds each rod 5 mm deep in its frame, so that the contact does not end.
    """
    depth, instances, connections = 5e-3, {}, []
    for n in range(len(mass)):
        instances[f"satellite{n}"] = {
            "fmu": "SatelliteDynamics",
            "form": "native",
            "start": {"mass": f"{mass[n]} kg", "position": f"{depth} m", "velocity": "1e-6 m/s"},
        }
        servo = {"omega_n": f"{omega_n[n]} rad/s", "xi_n": f"{xi_n[n]} 1", "tau_m": f"{tau[n]} s"}
        instances[f"robot{n}"] = {
            "fmu": "RobotResponse",
            "start": {**servo, "position": f"{depth} m"},
        }
        law = {"stiffness": f"{stiffness[n]} N/m", "damping": f"{damping[n]} N.s/m"}
        instances[f"contact{n}"] = {
            "fmu": "DockingContact",
            "start": {**law, "front": "0 m", "rear": "-1 m"},
        }
        hold = [{"offset": f"{stiffness[n] * depth} N"}]
        connections += [
            f"satellite{n}.position -> robot{n}.command",
            f"robot{n}.position -> contact{n}.position",
            f"robot{n}.velocity -> contact{n}.velocity",
            {"from": f"contact{n}.force", "to": f"satellite{n}.force", "through": hold},
        ]
    names = [f"satellite{n}.position" for n in range(len(mass))]
    times = {"step_size": "0.4 ms", "stop_time": "2 s", "record": names}
    config = {
        "run": {"master": "gauss-seidel", **times},
        "instances": instances,
        "connections": connections,
    }
    results = run(config, halving=False).results
    size = np.abs(np.array([results[name] for name in names]) - depth)
    # Half the slowest period, 0.69 s, fits into either.
    early = (results.time > 0.2) & (results.time < 0.6)
    late = (results.time > 1.6) & (results.time < 2.0)
    return size[:, late].max(axis=1) > size[:, early].max(axis=1)


def test_sign_of_stability_of_200_random_rigs():
    random = np.random.default_rng(20261121)
    count = 200
    mass = random.uniform(50, 600, count)
    stiffness = 10 ** random.uniform(4.7, 5.7, count)
    omega_n = 2 * np.pi * random.uniform(20, 120, count)
    xi_n = random.uniform(0.3, 1.2, count)
    tau = random.uniform(1e-3, 1e-2, count)
    damping = random.uniform(0, 2.5, count) * stiffness * (tau + 2 * xi_n / omega_n)
    rigs = {
        "satellite.mass": mass,
        "contact.stiffness": stiffness,
        "contact.damping": damping,
        "robot.omega_n": omega_n,
        "robot.xi_n": xi_n,
        "robot.tau_m": tau,
    }
    loop = Loop.of(PLAIN)

    def unstable(factor: float) -> np.ndarray:
        return (
            unstable_roots(
                loop.with_parameters({**rigs, "contact.damping": factor * damping}).characteristic()
            )
            > 0
        )

    judged = unstable(1.0)
    assert 40 < judged.sum() < 160
    simulated = grows(mass, stiffness, damping, omega_n, xi_n, tau)
    near_border = unstable(0.99) != unstable(1.01)
    assert near_border.sum() < 10
    assert not np.any((judged != simulated) & ~near_border)


@pytest.mark.parametrize("estimate", [300.0, 800.0])
def test_active_controller_with_a_wrong_damping(estimate):
    overrides = [
        *STILL,
        "controller.initial_stiffness=176 N/mm",
        f"controller.initial_damping={estimate} N.s/m",
        "contact.damping=500 N.s/m",
    ]
    loop = Loop.of("docking-1d", overrides).with_parameters({"controller.damping_estimate": estimate})
    predicted = predict_contact(loop).velocity_ratio
    assert predicted == pytest.approx(restitutions("docking-1d", overrides)[0], abs=4e-4)


def test_chart_agrees_with_certified_roots_and_the_rule():
    loop = Loop.of(PLAIN)
    drawn = chart(
        loop, ("robot.tau_m", np.linspace(0, 0.04, 60)), ("contact.damping", np.linspace(0, 4000, 50))
    )
    assert drawn.unstable.shape == drawn.growth.shape == drawn.rule.shape == (50, 60)
    random = np.random.default_rng(1)
    for row, column in zip(random.integers(50, size=25), random.integers(60, size=25), strict=True):
        values = {"robot.tau_m": drawn.x[column], "contact.damping": drawn.y[row]}
        roots = rightmost_roots(loop.with_parameters(values).characteristic(), 4)
        assert (roots.unstable > 0) == (drawn.unstable[row, column] > 0)
        if np.isfinite(drawn.growth[row, column]):
            near = np.exp(
                np.pi * roots.values.real / np.where(roots.values.imag > 0, roots.values.imag, np.nan)
            )
            assert np.nanmin(np.abs(near - drawn.growth[row, column])) < 1e-8
    assert drawn.rule[0, 0] == pytest.approx(-176e3 * 2 * 0.8 / 471.23889803846896)
    short = drawn.x < 1e-3
    assert np.mean((drawn.rule[:, short] > 0) == drawn.stable[:, short]) > 0.97


@pytest.mark.parametrize(
    ("x", "y"),
    [
        ("controller.stiffness_estimate", "robot.tau_m"),
        ("satellite.mass", "contact.stiffness"),
        ("robot.xi_n", "sensor.cutoff"),
    ],
)
def test_charts_over_other_parameters_of_the_active_loop(x, y):
    spans = {
        "controller.stiffness_estimate": np.linspace(100e3, 250e3, 5),
        "robot.tau_m": np.linspace(1e-3, 1e-2, 4),
        "satellite.mass": np.linspace(50, 500, 5),
        "contact.stiffness": np.geomspace(1e4, 1e6, 4),
        "robot.xi_n": np.linspace(0.3, 1.2, 5),
        "sensor.cutoff": np.array([0.0, 50.0, 100.0, 300.0]),
    }
    loop = Loop.of("docking-1d", ["contact.damping=100 N.s/m", "sensor.tau_s=1 ms", "controller.tau_s=1 ms"])
    drawn = chart(loop, (x, spans[x]), (y, spans[y]))
    for row, column in ((0, 0), (3, 4), (2, 1)):
        values = {x: spans[x][column], y: spans[y][row]}
        if values.get("sensor.cutoff") == 0.0:
            continue
        roots = rightmost_roots(loop.with_parameters(values).characteristic(), 4)
        assert drawn.unstable[row, column] == roots.unstable


@pytest.mark.parametrize("master", ["jacobi", "gauss-seidel"])
def test_effects_are_part_of_the_sampled_loop(master):
    """A delay of no whole number of steps, and a lag, as the co-simulation has them."""
    overrides = [
        "connections[satellite.force].through=[{delay: 0.33 ms}, {low-pass: 200 Hz}]",
        f"run.master={master}",
        "run.step_size=0.5 ms",
    ]
    predicted = sample(Loop.of(PLAIN, overrides), master, 5e-4).growth()
    assert predicted == pytest.approx(restitutions(PLAIN, overrides)[0], rel=1e-4)


def test_a_gain_in_the_path_back_counts_in_the_impulse():
    overrides = ["connections[satellite.force].through=[{gain: 0.5}]"]
    predicted = predict_contact(Loop.of(PLAIN, overrides)).velocity_ratio
    assert predicted == pytest.approx(restitutions(PLAIN, overrides)[0], rel=1e-5)


def test_effects_with_instants_of_their_own_are_refused():
    loop = Loop.of(PLAIN, ["connections[satellite.force].through=[{sample-and-hold: 4 ms}]"])
    with pytest.raises(ConfigError, match="sample-and-hold samples at instants of its own"):
        sample(loop, "jacobi", 1e-3)
