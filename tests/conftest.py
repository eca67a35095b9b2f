"""FMUs that are built for the tests."""

from __future__ import annotations

import signal
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import fmpy.logging
import pytest
from hypothesis import settings

from tests.extent import FULL

with suppress(ImportError):
    # Before an FMU's own copy, which lacks the binaries, can stand for it.
    import pythonfmu  # noqa: F401

# How long an example takes says something about the machine.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")

# fmpy's proxy of FMI 2 loggers serves the logger that was registered last in a process, which `simulate_fmu`
# drops when it ends: FMUs that other tests run by fmpy would log into freed memory.
_LOGGERS: list[object] = []
_add_logger_proxy = fmpy.logging.addLoggerProxy


def _add_lasting_logger_proxy(callbacks: object) -> None:
    _LOGGERS.append(callbacks)
    _add_logger_proxy(callbacks)


fmpy.logging.addLoggerProxy = _add_lasting_logger_proxy

SOURCES = Path(__file__).parent / "fmu_sources"


def pytest_configure() -> None:
    """A shell that starts the tests in the background has them ignore interrupts; some tests raise them."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def python_fmu(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Build tests/fmu_sources/<name>.py, once per session; gives the path of the FMU."""
    from pythonfmu import FmuBuilder

    folder = tmp_path_factory.mktemp("python_fmus")
    built: dict[str, Path] = {}

    def build(name: str) -> Path:
        if name not in built:
            options = {"canGetAndSetFMUstate": True, "canSerializeFMUstate": True}
            built[name] = Path(FmuBuilder.build_FMU(SOURCES / f"{name}.py", dest=folder, **options))
        return built[name]

    return build


@pytest.fixture(scope="session")
def c_fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The FMI 3.0 FMU of tests/fmu_sources/types3.c, for this platform only."""
    import fmpy

    folder = tmp_path_factory.mktemp("c_fmu")
    library = folder / f"Types3{fmpy.sharedLibraryExtension}"
    source = SOURCES / "types3.c"
    command = [sys.executable, "-m", "ziglang", "cc", "-shared", "-fPIC", "-O1", "-fno-sanitize=all"]
    subprocess.run([*command, "-o", str(library), str(source)], check=True, capture_output=True)
    path = folder / "Types3.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.write(SOURCES / "types3.xml", "modelDescription.xml")
        archive.write(library, f"binaries/{fmpy.platform_tuple}/{library.name}")
    return path


@pytest.fixture(scope="session", autouse=True)
def _python_fmus_end_well() -> Iterator[None]:
    """Some tests drive Python FMUs through fmpy alone, which does not know of pythonfmu's fault at exit."""
    from fmpy.fmi1 import _FMU

    from orchestrator.fmi.library import release_python_state

    free = _FMU.freeLibrary

    def free_library(self: _FMU) -> None:
        release_python_state(self.dll)
        free(self)

    _FMU.freeLibrary = free_library
    yield
    _FMU.freeLibrary = free


# Tests that take long, by folder or file: `pytest -m "not slow"` leaves them out.
_SLOW = (
    "campaign",
    "cli/fmu_tools",
    "cli/test_json_output.py",
    "clients",
    "diagnosis",
    "docking",
    "effects/test_effect_configs.py",
    "effects/test_effects_in_loops.py",
    "exchange/test_one_fmu.py",
    "exchange/test_ssp_identity.py",
    "exchange/test_system_fmu.py",
    "fmi/test_isolated.py",
    "fmus",
    "frequency/test_describing.py",
    "frequency/test_growth.py",
    "frequency/test_late_inputs.py",
    "frequency/test_sampled_system.py",
    "frequency/test_stability_command.py",
    "fuzz",
    "base/test_compiled_functions.py",
    "master/test_convergence.py",
    "report",
    "results/test_column_stream.py",
    "simulation",
    "system/test_scale.py",
    "test_code_style.py",
    "test_notebooks.py",
    "test_test_run.py",
    "test_tutorials.py",
    "translate",
)


# Each takes from half a minute to five: FULL_TESTS=1 runs them. Shorter ones of the same subjects always run.
_LONGEST = (
    "diagnosis/test_calibrate.py::test_the_calibration_is_learned_by_its_command",
    "diagnosis/test_challenge.py::test_the_same_seed_gives_the_same_bytes",
    "diagnosis/test_challenge_rig.py::test_a_dent_of_the_derivatives_hides_no_imitation",
    "diagnosis/test_challenge_rig.py::test_an_effect_imitates_itself",
    "diagnosis/test_challenge_rig.py::test_coloured_noise_of_the_force_hides_what_is_slow",
    "diagnosis/test_challenge_rig.py::test_evidence_falls_with_the_magnitude_and_calibration_explains_its_part",
    "diagnosis/test_challenge_rig.py::test_little_coloured_noise_is_that_of_any_rig",
    "diagnosis/test_challenge_rig.py::test_of_a_pair_the_other_effect_may_have_any_size",
    "diagnosis/test_challenge_rig.py::test_two_effects_imitate_what_one_does_not",
    "diagnosis/test_challenge_rig.py::test_what_an_effect_shows_counts_from_what_the_lab_believes",
    "diagnosis/test_challenge_rig.py::test_what_another_effect_imitates_cannot_be_distinguished_from_it",
    "diagnosis/test_challenge_rig.py::test_what_roughness_explains_is_no_evidence",
    "diagnosis/test_evidence.py::test_a_clear_effect_is_found_in_its_size_beside_a_random_link",
    "diagnosis/test_evidence.py::test_a_sensor_with_a_cycle_of_its_own_is_not_one_that_loses_samples",
    "diagnosis/test_evidence.py::test_contacts_that_begin_a_little_early_or_late_are_roughness",
    "diagnosis/test_residual_evidence.py::test_frames_that_stand_elsewhere_each_time_are_outside",
    "diagnosis/test_outside_place.py::test_oddities_are_found_where_they_act[robot.encoder-walk-robot]",
    "diagnosis/test_outside_place.py::test_oddities_are_found_where_they_act[robot.vibration-robot]",
    "diagnosis/test_robot_limits.py::test_a_deep_limit_leaves_little[names1-1.0-7-4]",
    "diagnosis/test_robot_limits.py::test_what_contacts_do_that_are_elsewhere_is_no_noise_of_the_force",
    "diagnosis/test_weigh.py::test_labelled_cases[case-009]",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the slow tests, and leave the longest to FULL_TESTS=1."""
    here = Path(__file__).parent
    for item in items:
        place = item.path.relative_to(here)
        if any(place.is_relative_to(one) for one in _SLOW) and "simulation/test_grid" not in place.as_posix():
            item.add_marker(pytest.mark.slow)
        if not FULL and f"{place.as_posix()}::{item.name}" in _LONGEST:
            item.add_marker(pytest.mark.skip(reason="takes long; FULL_TESTS=1 runs it"))
