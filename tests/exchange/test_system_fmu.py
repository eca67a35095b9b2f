"""A system exported as one FMU does what `run` does, in fmpy and as a part of another system."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from fractions import Fraction
from pathlib import Path

import fmpy
import numpy as np
import pytest
from assembled import assemble
from fmpy.fmi2 import FMU2Slave
from fmpy.validation import validate_fmu

from orchestrator.base.errors import ConfigError, StepError
from orchestrator.cli.exchange import _names
from orchestrator.cli.main import main
from orchestrator.config import load_config
from orchestrator.effects import effect_names
from orchestrator.exchange.system_contents import EFFECTS, native_config
from orchestrator.exchange.system_fmu import export_system_fmu
from orchestrator.fmi import load_fmu
from orchestrator.master.jacobi import Jacobi
from orchestrator.simulation.grid import Grid
from orchestrator.simulation.loop import simulate
from orchestrator.simulation.run import run
from orchestrator.system.assembly import Part
from orchestrator.translate.build import build
from orchestrator.translate.coupled import binary, build_binaries
from orchestrator.translate.package import PLATFORMS
from tests import foreign

HERE = "x86_64-linux"
VERSIONS = pytest.mark.parametrize("version", ["2.0", "3.0"])
# Every effect, and instances with steps of their own.
EFFECTS_CONFIG = """
extends: docking-1d-uncompensated
run: {stop_time: 0.6 s, step_size: 0.5 ms}
instances:
  contact: {step_size: 1 ms}
  satellite: {step_size: 0.25 ms}
connections:
  - robot.position -> contact.position
  - {from: robot.velocity, to: contact.velocity, through: [{delay: {time: 0.3 ms, before: 20 mm/s}},
     {relay: 20 mm/s, width: 1 mm/s}]}
  - from: [contact.force, {port: robot.velocity, gain: 3 N.s/m}]
    to: satellite.force
    through:
      - {delay: 1.3 ms}
      - {low-pass: 200 Hz}
      - {gain: 1.01}
      - {offset: 0.5 N}
      - {quantise: 0.01 N}
      - {saturate: {low: -3000 N, high: 3000 N}}
      - {noise: {deviation: 1 N, period: 1 ms, seed: 3}}
      - {noise: {deviation: 1 N, period: 1 ms, seed: 4, correlation: 5 ms}}
      - {drift: 2 N/s}
      - {dropout: {probability: 0.2, period: 1 ms, phase: 2.5 ms, seed: 5}}
      - {jitter: {jitter: 1 ms, period: 1 ms, seed: 6}}
      - {rate-limit: 1e6 N/s}
      - {dead-band: 0.1 N}
      - {sample-and-hold: 1 ms}
  - {from: satellite.position, to: robot.command, through: [{backlash: 1 um}]}
measures: {}
"""


def exported(tmp_path, config, name="system.fmu", **options):
    report = export_system_fmu(config, tmp_path / name, **options)
    assert validate_fmu(str(report.path)) == []
    return report


def reference(config, overrides=()):
    return run(native_config(load_config(config, overrides)), halving=False, figures=False).results


def in_fmpy(report, results, every=1):
    return fmpy.simulate_fmu(
        str(report.path),
        start_time=float(results.time[0]),
        stop_time=float(results.time[-1]),
        step_size=every * report.step_size,
        output_interval=every * report.step_size,
    )


@VERSIONS
@pytest.mark.parametrize(
    ("config", "overrides"),
    [
        ("docking-1d-uncompensated", ["run.stop_time=1 s"]),
        ("docking-1d", ["run.stop_time=1 s", "run.master=jacobi"]),
        ("docking-6d-wall", ["run.stop_time=0.5 s"]),
        ("docking-lab", ["run.stop_time=0.5 s"]),
    ],
)
def test_signals_are_those_of_run_to_the_bit(tmp_path, version, config, overrides):
    report = exported(tmp_path, config, overrides=overrides, fmi_version=version)
    assert set(report.platforms) == set(PLATFORMS)
    results = reference(config, overrides)
    reported = in_fmpy(report, results)
    assert np.allclose(reported["time"], results.time, rtol=0.0, atol=1e-12)  # fmpy adds steps up
    for name in report.outputs:
        assert np.array_equal(reported[name], results[name]), name


@pytest.mark.parametrize("master", ["jacobi", "gauss-seidel"])
def test_effects_sums_and_own_steps_are_those_of_run_to_the_bit(tmp_path, master):
    config = tmp_path / "effects.yaml"
    config.write_text(EFFECTS_CONFIG)
    overrides = [f"run.master={master}"]
    report = exported(tmp_path, config, overrides=overrides)
    results = reference(config, overrides)
    reported = in_fmpy(report, results)
    assert np.ptp(results["contact.force"]) > 100.0
    for name in report.outputs:
        assert np.array_equal(reported[name], results[name]), name


def test_every_effect_is_known_inside():
    used = [name for name in EFFECTS if f"{name}:" in EFFECTS_CONFIG]
    assert set(effect_names()) <= set(EFFECTS)
    assert set(effect_names()) - set(used) <= {"map"}  # for integers; see the test of foreign FMUs


PART = """
run: {master: gauss-seidel, step_size: 0.1 ms, stop_time: 1 s}
instances:
  satellite:
    fmu: SatelliteDynamics
    start: {mass: 279.06976744186045 kg, position: 0 m, velocity: 20 mm/s, force: 0 N}
  robot:
    fmu: ROBOT
    start: {omega_n: 75 Hz, xi_n: 0.8, tau_m: 2 ms}
connections:
  - satellite.position -> robot.command
"""
WHOLE = """
run: {master: gauss-seidel, step_size: 0.1 ms, stop_time: 1 s}
instances:
  part: {fmu: part.fmu, start: {robot.tau_m: 2 ms}}
  contact:
    fmu: DockingContact
    start: {stiffness: 176 N/mm, damping: 0 N.s/mm, front: 5 mm, rear: -5 mm}
connections:
  - part.robot.position -> contact.position
  - part.robot.velocity -> contact.velocity
  - contact.force -> part.satellite.force
"""


@VERSIONS
@pytest.mark.parametrize("robot", ["RobotResponse", "RobotResponse-fmi3"])
def test_a_part_of_a_system_does_the_same_as_its_instances(tmp_path, version, robot):
    (tmp_path / "part.yaml").write_text(PART.replace("ROBOT", robot))
    (tmp_path / "whole.yaml").write_text(WHOLE)
    ports = ["robot.position", "robot.velocity", "satellite.position"]
    report = exported(tmp_path, tmp_path / "part.yaml", "part.fmu", fmi_version=version, ports=ports)
    assert report.inputs == ("satellite.force",)
    assert report.outputs == tuple(ports)
    reported = run(tmp_path / "whole.yaml", halving=False, figures=False).results
    results = reference("docking-1d-uncompensated", ["run.stop_time=1 s"])
    for name in ports:
        assert np.array_equal(reported[f"part.{name}"], results[name]), name
    assert np.array_equal(reported["contact.force"], results["contact.force"])
    # The whole, with the part in it, becomes an FMU once more.
    again = exported(tmp_path, tmp_path / "whole.yaml", fmi_version=version)
    assert "part.satellite.position" in again.outputs
    assert np.array_equal(in_fmpy(again, results)["contact.force"], results["contact.force"])


def test_parameters_have_the_config_s_values_and_units_and_can_be_changed(tmp_path):
    report = exported(tmp_path, "docking-1d-uncompensated", overrides=["run.stop_time=0.6 s"])
    described = {one.name: one for one in fmpy.read_model_description(str(report.path)).modelVariables}
    assert float(described["robot.tau_m"].start) == 2e-3
    assert described["robot.tau_m"].unit == "s"
    assert float(described["contact.stiffness"].start) == 176e3
    changed = reference("docking-1d-uncompensated", ["run.stop_time=0.6 s", "robot.tau_m=6 ms"])
    reported = fmpy.simulate_fmu(
        str(report.path),
        stop_time=0.6,
        step_size=1e-4,
        output_interval=1e-4,
        start_values={"robot.tau_m": 6e-3},
    )
    assert np.array_equal(reported["contact.force"], changed["contact.force"])
    assert not np.array_equal(
        changed["contact.force"],
        reference("docking-1d-uncompensated", ["run.stop_time=0.6 s"])["contact.force"],
    )


def test_communication_steps_are_whole_multiples_of_its_own(tmp_path):
    report = exported(tmp_path, "docking-1d-uncompensated", overrides=["run.stop_time=0.5 s"])
    results = reference("docking-1d-uncompensated", ["run.stop_time=0.5 s"])
    reported = in_fmpy(report, results, every=5)
    assert np.array_equal(reported["contact.force"], results["contact.force"][::5])
    with Instance(report.path) as slave:
        slave.start()
        with pytest.raises(Exception, match="DoStep"):
            slave.fmu.doStep(0.0, 1.5e-4)
        assert slave.log == [
            "DoStep: by 0.00014999999999999999 s, which is 1.5 of the system's own steps of "
            f"{1e-4:.17g} s; only whole multiples of that are possible"
        ]
        slave.fmu.doStep(0.0, 2e-4)  # a refusal changes nothing


class Instance:
    """An instance of an FMI 2.0 FMU in fmpy."""

    def __init__(self, path: Path) -> None:
        described = fmpy.read_model_description(str(path))
        self.names = {one.name: one.valueReference for one in described.modelVariables}
        self.log: list[str] = []
        self._folder = fmpy.extract(str(path))
        self.fmu = FMU2Slave(
            guid=described.guid,
            unzipDirectory=self._folder,
            modelIdentifier=described.coSimulation.modelIdentifier,
            instanceName="whole",
        )
        functions = fmpy.fmi2.fmi2CallbackFunctions()
        functions.logger = fmpy.fmi2.fmi2CallbackLoggerTYPE(
            lambda environment, name, status, category, message: self.log.append(message.decode())
        )
        functions.allocateMemory = fmpy.fmi2.fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
        functions.freeMemory = fmpy.fmi2.fmi2CallbackFreeMemoryTYPE(fmpy.free)
        self.fmu.instantiate(callbacks=functions)

    def __enter__(self) -> Instance:
        return self

    def __exit__(self, *error: object) -> None:
        self.fmu.freeInstance()

    def start(self) -> None:
        self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def steps(self, first: int, end: int, size: float = 1e-4) -> list[list[float]]:
        rows = []
        for index in range(first, end):
            self.fmu.doStep(index * size, size)
            rows.append(self.fmu.getReal([self.names["contact.force"], self.names["robot.position"]]))
        return rows


def test_states_reset_and_several_instances_in_one_process(tmp_path):
    config = tmp_path / "effects.yaml"
    config.write_text(EFFECTS_CONFIG)
    # A contact from 0.25 s on; steps of 0.5 ms.
    report = exported(tmp_path, config)
    with Instance(report.path) as one, Instance(report.path) as other:
        one.start()
        other.start()
        one.steps(0, 500, 5e-4)
        state = one.fmu.getFMUState()
        rows = one.steps(500, 700, 5e-4)
        assert np.ptp(rows, axis=0)[0] > 100.0
        one.fmu.setFMUState(state)
        assert one.steps(500, 700, 5e-4) == rows
        data = one.fmu.serializeFMUState(state)
        one.fmu.freeFMUState(state)
        # The other one is where it began; what the first one was goes over to it.
        restored = other.fmu.deserializeFMUState(data)
        other.fmu.setFMUState(restored)
        other.fmu.freeFMUState(restored)
        assert other.steps(500, 700, 5e-4) == rows
        with pytest.raises(Exception, match="SerializeFMU"):
            other.fmu.deserializeFMUState(data[:-1] + bytes([data[-1] ^ 1]))
        one.fmu.reset()
        one.start()
        one.steps(0, 500, 5e-4)
        assert one.steps(500, 700, 5e-4) == rows


def test_initial_values_answer_at_once(tmp_path):
    report = exported(tmp_path, "docking-1d-uncompensated")
    with Instance(report.path) as slave:
        slave.fmu.setupExperiment(startTime=0.0)
        slave.fmu.enterInitializationMode()
        force = [slave.names["contact.force"]]
        assert slave.fmu.getReal(force) == [0.0]
        slave.fmu.setReal([slave.names["contact.front"]], [-1e-3])
        assert abs(slave.fmu.getReal(force)[0]) == pytest.approx(176.0, rel=1e-9)


AMPLIFIER = """
model Amplifier
  parameter Real k = 1;
  parameter Real c = 0;
  input Real u;
  output Real y;
equation
  y = k*u + c;
end Amplifier;
"""
LOOP = """
run: {master: gauss-seidel, step_size: 1 ms, stop_time: 20 ms}
instances:
  a: {fmu: Amplifier.fmu, start: {k: -0.5, c: 3}}
  b: {fmu: Amplifier.fmu, start: {k: 0.9, c: 1}}
connections:
  - a.y -> b.u
  - {from: b.y, to: a.u, through: [{delay: 1 ms}]}
"""


def test_an_algebraic_loop_at_initialisation_is_solved(tmp_path):
    (tmp_path / "Amplifier.mo").write_text(AMPLIFIER)
    build(tmp_path / "Amplifier.mo", tmp_path / "Amplifier.fmu", platforms=[HERE])
    (tmp_path / "loop.yaml").write_text(LOOP)
    report = exported(tmp_path, tmp_path / "loop.yaml")
    assert report.platforms == (HERE,)
    assert report.notes[0] == ("not for x86_64-windows, for which these have no binary: Amplifier.fmu")
    results = reference(tmp_path / "loop.yaml")
    reported = in_fmpy(report, results)
    # a = 3 - 0.5 b, b = 1 + 0.9 a.
    assert results["a.y"][0] == pytest.approx(2.5 / 1.45, rel=1e-12)
    for name in ("a.y", "b.y"):
        assert np.allclose(reported[name], results[name], rtol=1e-12, atol=0.0)


FOREIGN = """
run: {master: jacobi, step_size: 0.1 s, stop_time: 2 s}
instances:
  one: {fmu: Arrays.fmu, start: {"gain[2,3]": 0.5, "u[1]": 2, "u[2]": 3, "u[3]": 4}}
  two: {fmu: Arrays.fmu, start: {"u[2]": 3, "u[3]": 4}}
  other:
    fmu: Types.fmu
    start: {word_in: hello, real_in: 0 m/s, single_in: 2 rad/s, count_in: 7, byte_in: 5, level_in: high,
            flag_in: true}
connections:
  - {from: "one.y[2]", to: "two.u[1]"}
"""


def test_foreign_fmus_with_arrays_and_all_types(tmp_path, c_fmu):
    foreign.arrays(tmp_path / "Arrays.fmu")
    (tmp_path / "Types.fmu").write_bytes(c_fmu.read_bytes())
    (tmp_path / "foreign.yaml").write_text(FOREIGN)
    report = exported(tmp_path, tmp_path / "foreign.yaml", fmi_version="3.0")
    results = reference(tmp_path / "foreign.yaml")
    reported = in_fmpy(report, results)
    assert "other.count_out" not in report.outputs
    assert "output other.count_out (UInt32) is left out: too large for Integer" in report.notes
    assert {"one.y[1]", "two.y[2]", "other.level_out", "other.flag_out", "other.byte_out"} <= set(
        report.outputs
    )
    for name in report.outputs:
        assert np.array_equal(reported[name], results[name]), name
    y = 4 * 2 + 5 * 3 + 0.5 * 4
    assert results["one.y[2]"][-1] == y
    assert results["two.y[2]"][-1] == 4 * y + 5 * 3 + 6 * 4


BEYOND = """
run: {master: jacobi, step_size: 0.1 s, stop_time: 1 s}
instances:
  a: {fmu: Types.fmu, start: {word_in: hello, real_in: 0 m/s, single_in: 2 rad/s, count_in: 300, byte_in: 5,
      level_in: high, flag_in: true}}
  b: {fmu: Types.fmu, start: {word_in: hello, real_in: 0 m/s, single_in: 2 rad/s, count_in: 7, level_in: high,
      flag_in: true}}
connections:
  - a.count_out -> b.byte_in
"""


def test_a_whole_number_beyond_an_inner_inputs_type_ends_the_run(tmp_path, c_fmu):
    (tmp_path / "Types.fmu").write_bytes(c_fmu.read_bytes())
    (tmp_path / "whole.yaml").write_text(BEYOND)
    with pytest.raises(StepError, match=r"b at time 0 s: byte_in \(Int8\) cannot hold 301"):
        reference(tmp_path / "whole.yaml")
    report = exported(tmp_path, tmp_path / "whole.yaml", fmi_version="3.0", inputs=[])
    parts = [Part("whole", load_fmu(report.path))]
    with pytest.raises(StepError, match="b: 301 is no value for an input"):
        simulate(assemble(parts), Jacobi(), Grid(Fraction(0), Fraction(1, 10), 10))


def test_the_binaries_are_those_of_their_sources(tmp_path):
    built = build_binaries(tmp_path)
    assert len(built) == 2 * len(PLATFORMS)
    for path in built:
        _, version, platform = path.stem.split("-", 2)
        assert path.read_bytes() == binary(platform, f"{version[-1]}.0"), path.name


def test_the_same_config_gives_the_same_bytes(tmp_path):
    one = exported(tmp_path, "docking-1d", "one.fmu")
    other = exported(tmp_path, "docking-1d", "other.fmu")
    assert one.path.read_bytes() == other.path.read_bytes()
    with zipfile.ZipFile(one.path) as archive:
        names = archive.namelist()
        assert "binaries/win64/docking_1d.dll" in names
        assert "binaries/darwin64/docking_1d.dylib" in names
        assert load_config(
            _written(tmp_path, archive.read("extra/orchestrator/system.yaml"))
        ).model.run.step_size


def _written(folder, content):
    path = folder / "inner.yaml"
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    ("overrides", "options", "message"),
    [
        (
            ["run.master={name: adaptive, tolerance: 1e-3, estimate: inputs}"],
            {},
            "run.master: the master adaptive cannot become part of an FMU\n"
            "  jacobi and gauss-seidel run inside an FMU, with inputs held over a step. "
            "Set run.master to gauss-seidel.",
        ),
        (
            ["instances.satellite.form=python"],
            {},
            "satellite (SatelliteDynamics) cannot become part of an FMU\n"
            "  it is Python code, which would not run in other tools. "
            "Take its native form: orchestrator build MODEL.py --form native.",
        ),
        (
            ["instances.contact.tolerance=1e-6"],
            {},
            "contact (DockingHIL.DockingContact) cannot become part of an FMU\n"
            "  it needs a tolerance, which the inner master does not pass on. "
            "Leave instances.contact.tolerance out.",
        ),
        (
            [],
            {"ports": ["contact.forc"]},
            "--ports: contact has no variable 'forc' to record",
        ),
        (
            [],
            {"inputs": ["robot.command"]},
            "--inputs: 'robot.command' cannot be an input of the FMU\n"
            "  satellite.position -> robot.command feeds it",
        ),
    ],
)
def test_what_cannot_become_an_fmu_is_reported(tmp_path, overrides, options, message):
    with pytest.raises(ConfigError) as raised:
        export_system_fmu("docking-1d-uncompensated", tmp_path / "x.fmu", overrides=overrides, **options)
    assert message in str(raised.value)
    assert not (tmp_path / "x.fmu").exists()


def test_a_missing_inner_binary_is_reported(tmp_path):
    report = exported(tmp_path, "docking-1d-uncompensated")
    spoilt = tmp_path / "spoilt.fmu"
    with zipfile.ZipFile(report.path) as whole, zipfile.ZipFile(spoilt, "w") as archive:
        for name in whole.namelist():
            if "/DockingContact/binaries/linux64" not in name:
                archive.writestr(name, whole.read(name))
    log: list[str] = []
    with pytest.raises(Exception, match="instantiate"):
        fmpy.simulate_fmu(str(spoilt), stop_time=0.1, logger=lambda *a: log.append(a[-1].decode()))
    assert "fmi2Instantiate: cannot load" in log[0]
    assert "DockingContact.so" in log[0]


def test_rigs_outside_of_the_run_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="it is no FMU of a file, but lives outside of the run"):
        export_system_fmu("docking-1d-station", tmp_path / "x.fmu")


def test_names_are_divided_by_commas_outside_of_brackets():
    assert _names("a.A[1,2], b.y ,a.x[3]") == ["a.A[1,2]", "b.y", "a.x[3]"]


def test_the_command(tmp_path, capsys):
    path = tmp_path / "x.fmu"
    assert main(["export", "docking-1d", "-o", str(path), "--fmi", "3", "--ports", "contact.force"]) == 0
    assert capsys.readouterr().out == (
        f"{path}: FMI 3.0 co-simulation, step size 0.0005 s\n"
        "  0 inputs, 1 output, 30 parameters\n"
        "  binaries: x86_64-linux, x86_64-windows, x86_64-darwin, aarch64-darwin\n"
    )
    assert main(["export", "docking-1d", "-o", str(tmp_path / "x.doc")]) == 2
    assert subprocess.run(["unzip", "-tq", str(path)], capture_output=True).returncode == 0


def test_an_export_needs_nothing_of_the_build_extra(tmp_path):
    """Whoever installs the package alone has neither compiler nor translator."""
    target = tmp_path / "X.fmu"
    code = (
        "import sys\n"
        "for one in ('casadi', 'pythonfmu', 'rumoca', 'ziglang'): sys.modules[one] = None\n"
        "from orchestrator.cli.main import main\n"
        f"sys.exit(main(['export', 'docking-1d-uncompensated', '-o', {str(target)!r}]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert zipfile.is_zipfile(target)
