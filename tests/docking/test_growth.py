"""Growth per contact from characteristic roots against co-simulation; stability of random rigs."""

import numpy as np
import pytest

from orchestrator.docking.stability import ContactLoop, predict_contact
from orchestrator.frequency import DelaySystem, Link, chart_of, sampled_system
from orchestrator.simulation.run import prepare, run

PLAIN = "docking-1d-uncompensated"


def restitutions(name: str, overrides: list[str]) -> list[float]:
    summary = run(name, overrides=[*overrides, "run.stop_time=1.2 s"], halving=False).summary
    return [abs(contact["cor"]) for contact in summary["contacts"]]


def stepped(name: str, overrides: list[str]) -> float:
    """Growth of the dominant root that the master and its step make."""
    prepared = prepare(name, overrides)
    modes = sampled_system(prepared, ContactLoop.of(prepared).linear).modes()
    root = next(one.root for one in modes if one.root.imag > 1e-3 * abs(one.root))
    return float(np.exp(np.pi * root.real / root.imag))


@pytest.mark.parametrize(
    "rig", [("75 Hz", "2 ms"), ("75 Hz", "4 ms"), ("75 Hz", "6 ms"), ("25 Hz", "2 ms"), ("100 Hz", "2 ms")]
)
def test_growth_of_the_uncompensated_system(rig):
    overrides = [f"robot.omega_n={rig[0]}", f"robot.tau_m={rig[1]}"]
    loop = ContactLoop.of(PLAIN, overrides)
    found = restitutions(PLAIN, overrides)[0]
    assert loop.growth == pytest.approx(found, rel=1e-3)
    assert predict_contact(loop).velocity_ratio == pytest.approx(found, rel=1e-5)


def test_damped_contact_ends_before_half_an_oscillation():
    overrides = ["contact.damping=500 N.s/m", "run.step_size=50 us"]
    predicted = predict_contact(ContactLoop.of(PLAIN, overrides))
    assert predicted.velocity_ratio == pytest.approx(np.mean(restitutions(PLAIN, overrides)), rel=1e-4)
    border = ContactLoop.of(PLAIN, ["contact.damping=955.73 N.s/m"])
    assert border.growth == pytest.approx(1, abs=1e-5)
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
    loop = ContactLoop.of("docking-1d", overrides, stiffness_estimate=estimate)
    predicted = predict_contact(loop).velocity_ratio
    assert predicted == pytest.approx(restitutions("docking-1d", overrides)[0], abs=1e-3)
    assert np.sign(round(loop.growth - 1, 6)) == np.sign(176e3 - estimate)


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
    assert stepped(PLAIN, [f"run.master={master}", f"run.step_size={step} s"]) == pytest.approx(
        growth, rel=2e-4
    )


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
    predicted = stepped(PLAIN, overrides)
    assert predicted == pytest.approx(restitutions(PLAIN, overrides)[0], rel=2e-4)
    assert predicted < 0.99 * ContactLoop.of(PLAIN, overrides).growth


def test_sampled_loop_with_sensor_and_controller():
    overrides = ["controller.mode=off", "sensor.tau_s=2 ms", "run.step_size=50 us"]
    predicted = stepped("docking-1d", overrides)
    assert predicted == pytest.approx(restitutions("docking-1d", overrides)[0], rel=3e-4)


def test_sampled_loop_tends_to_the_continuous_one():
    rig = ["contact.damping=1500 N.s/m", "robot.tau_m=2.3 ms"]
    limit = ContactLoop.of(PLAIN, rig).growth
    errors = {
        master: [
            stepped(PLAIN, [*rig, f"run.master={master}", f"run.step_size={step} ms"]) - limit
            for step in (0.4, 0.2, 0.1)
        ]
        for master in ("jacobi", "gauss-seidel")
    }
    assert errors["jacobi"][1] / errors["jacobi"][2] == pytest.approx(2.0, rel=0.05)
    # The contact's damping acts on a velocity that is not the step's mean: of first order, too, but small.
    assert abs(errors["gauss-seidel"][2]) < 0.1 * abs(errors["jacobi"][2])


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


def rig(mass, stiffness, damping, omega_n, xi_n, tau) -> DelaySystem:
    """The equations of a rig in contact, written down here."""
    a = np.zeros((4, 4))
    a[0, 1] = a[2, 3] = 1.0
    a[3, 2:] = [-(omega_n**2), -2.0 * xi_n * omega_n]
    b = np.zeros((4, 2))
    b[1, 0], b[3, 1] = 1.0 / mass, omega_n**2
    c = np.array([[1.0, 0, 0, 0], [0, 0, -stiffness, -damping]])
    links = (Link("command", 0, 1, 1.0, tau), Link("force", 1, 0, 1.0))
    names = ("s.x", "s.v", "r.x", "r.v"), ("s.force", "r.command"), ("s.position", "r.force")
    return DelaySystem(a, b, c, np.zeros((2, 2)), *names, links)


def test_the_equations_of_a_rig_are_those_of_its_config():
    found = ContactLoop.of(PLAIN, ["contact.damping=300 N.s/m"]).linear.modes().modes
    mass = 300.0 * 4000.0 / 4300.0
    expected = rig(mass, 176e3, 300.0, 150.0 * np.pi, 0.8, 2e-3).modes().modes
    for one, other in zip(found[:2], expected[:2], strict=True):
        assert one.root == pytest.approx(other.root, rel=1e-6)


def test_the_border_of_a_chart_is_where_the_damping_stops_the_growth():
    """955.7 N.s/m at 2 ms, 1686.1 at 6 ms."""
    mass = 300.0 * 4000.0 / 4300.0

    def made(tau: float, damping: float) -> DelaySystem:
        return rig(mass, 176e3, damping, 150.0 * np.pi, 0.8, tau)

    drawn = chart_of(made, (1e-3, 8e-3), (100.0, 3000.0))
    assert drawn.unstable.shape == (201, 201)
    (line,) = drawn.border
    line = line[np.argsort(line[:, 0])]
    assert np.interp([2e-3, 6e-3], line[:, 0], line[:, 1]) == pytest.approx([955.73, 1686.1], rel=1e-4)
    draw = np.random.default_rng(1)
    for row, column in draw.integers(201, size=(40, 2)):
        system = made(drawn.x[column], drawn.y[row])
        assert drawn.unstable[row, column] == system.count_right_of(0.0)


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

    def unstable(factor: float) -> np.ndarray:
        rows = zip(*(rigs | {"contact.damping": factor * damping}).values(), strict=True)
        return np.array([rig(*row).count_right_of(0.0) > 0 for row in rows])

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
    loop = ContactLoop.of("docking-1d", overrides, damping_estimate=estimate)
    predicted = predict_contact(loop).velocity_ratio
    assert predicted == pytest.approx(restitutions("docking-1d", overrides)[0], abs=4e-4)


@pytest.mark.parametrize("master", ["jacobi", "gauss-seidel"])
def test_effects_are_part_of_the_sampled_loop(master):
    """A delay of no whole number of steps, and a lag, as the co-simulation has them."""
    overrides = [
        "connections[satellite.force].through=[{delay: 0.33 ms}, {low-pass: 200 Hz}]",
        f"run.master={master}",
        "run.step_size=0.5 ms",
    ]
    predicted = stepped(PLAIN, overrides)
    assert predicted == pytest.approx(restitutions(PLAIN, overrides)[0], rel=1e-4)


def test_a_gain_in_the_path_back_counts_in_the_impulse():
    overrides = ["connections[satellite.force].through=[{gain: 0.5}]"]
    predicted = predict_contact(ContactLoop.of(PLAIN, overrides)).velocity_ratio
    assert predicted == pytest.approx(restitutions(PLAIN, overrides)[0], rel=1e-5)
