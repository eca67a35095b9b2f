"""Habits of exporters, each imitated by quirks.c: what threads about their FMUs tell.

A strict end of time: 20-sim and MapleSim (modelica/fmi-cross-check, thread 64). A stop time that is read
whether or not it is defined: EnergyPlus (lbl-srg/EnergyPlusToFMU, 10). No folder of resources:
Simulink (CATIA-Systems/FMU-Standalone-App, 1). A crash when a run ends: OpenModelica with CVODE (16319).
"""

from __future__ import annotations

import os
import sys
import tempfile
import threading
from pathlib import Path

import foreign
import numpy as np
import pytest
from archives import repack

from orchestrator.base.errors import FmuError, StepError
from orchestrator.fmi import Kind, Point, load_fmu
from orchestrator.fmi.working_directory import return_to, returning, working_directory
from orchestrator.simulation.run import prepare, run

linux = pytest.mark.skipif(sys.platform != "linux", reason="how Linux looks for libraries")


def config(path, step="0.1 s", stop="0.6 s", **instance):
    start = {"u": 1, "level": "low", "Verstärkung": 1, **instance.pop("start", {})}
    return {
        "run": {"master": "jacobi", "step_size": step, "stop_time": stop, "loop": "python"},
        "instances": {"one": {"fmu": str(path), "start": start, **instance}},
    }


@pytest.fixture
def quirky(tmp_path):
    return lambda habit="", **options: foreign.quirks(tmp_path / "an FMU.fmu", habit, **options)


def seen(path, **options):
    made = run(config(path, **options), halving=False)
    assert made.results["one.y"] == pytest.approx(made.results.time)
    return int(made.results["one.seen"][-1]), made.summary["run"]["log"]


@pytest.mark.parametrize("habit", ["{strict guid}", "bare guid"])
def test_the_guid_is_handed_over_as_it_is_written(habit, quirky):
    seen(quirky(habit))


@pytest.mark.parametrize("isolation", [{}, {"isolate": "process"}])
def test_a_tolerance_is_reported_where_one_is_given(isolation, quirky):
    assert seen(quirky("tolerance"), tolerance=3e-8, **isolation)[0] == 30
    assert seen(quirky("tolerance"), **isolation)[0] == -1


def test_a_stop_time_is_reported_as_defined(quirky):
    assert seen(quirky("stop"))[0] == 1


@pytest.mark.parametrize(("step", "stop"), [("0.1 s", "0.3 s"), ("0.1 s", "0.8 s"), ("0.7 ms", "2.1 ms")])
def test_no_step_goes_beyond_the_stop_time_that_was_reported(step, stop, quirky):
    # 0.2 + 0.1 is more than 0.3 by a rounding.
    seen(quirky("strict stop"), step=step, stop=stop)


@pytest.mark.parametrize("own", ["0.1 ms", "4.9 ms"])
def test_no_step_of_its_own_goes_beyond_it_either(own, quirky):
    path = quirky("strict stop")
    for count in range(7, 70, 7):
        made = run(config(path, step="0.7 ms", stop=f"{0.7 * count:.1f} ms", step_size=own), halving=False)
        assert made.results["one.y"][-1] == pytest.approx(made.results.time[-1])


def test_a_step_that_is_too_long_is_reported_with_how_far_it_came(quirky):
    with pytest.raises(StepError) as caught:
        run(config(quirky("short steps")), halving=False)
    assert str(caught.value) == (
        "one at time 0 s: refused a step of 0.1 s, it came to 0.05 s\n  Take a smaller step size."
    )
    assert seen(quirky("short steps"), step="50 ms")[0] == 0


@pytest.mark.parametrize("habit", ["resources", "naive resources"])
def test_resources_are_found_from_a_path_with_spaces(habit, quirky):
    assert seen(quirky(habit, resources=True))[0] == 17


def test_resources_are_found_where_temporary_files_have_spaces_and_umlauts(quirky, tmp_path, monkeypatch):
    folder = tmp_path / "temporäre Dateien"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    assert seen(quirky("resources", resources=True))[0] == 17
    assert list(folder.glob("*/fmu-*")) == []


def test_the_folder_of_resources_is_there_without_any(quirky):
    instance = load_fmu(quirky()).instantiate("one")
    assert (Path(instance._slave.unzipDirectory) / "resources").is_dir()
    instance.free()


def test_an_fmu_that_changes_the_working_directory_moves_no_results(quirky, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    quirky("changes directory")
    run(config("an FMU.fmu"), out="out")
    assert os.getcwd() == str(tmp_path)
    assert {"results.csv", "summary.json"} <= {one.name for one in (tmp_path / "out").iterdir()}


def test_relative_paths_hold_for_instances_made_after_such_an_fmu(quirky, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    quirky("changes directory")
    foreign.quirks(tmp_path / "other.fmu")
    both = config("an FMU.fmu")
    both["instances"]["two"] = config("other.fmu")["instances"]["one"]
    results = run(both, halving=False).results
    assert results["two.y"].tolist() == results["one.y"].tolist()


def test_threads_are_reported_no_folder_that_another_one_loads_an_fmu_from(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    reported: list[str | None] = []
    asking = threading.Thread(target=lambda: reported.append(working_directory()))
    inside = tmp_path / "an FMU"
    inside.mkdir()
    with returning():
        os.chdir(inside)  # as fmpy does while it loads
        asking.start()
        asking.join(0.2)
        assert reported == []
    asking.join()
    assert reported == [str(tmp_path)] == [os.getcwd()]


def test_threads_that_need_an_fmu_at_once_unpack_it_once(quirky, tmp_path, monkeypatch):
    fmu = load_fmu(quirky())
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    unpacked, unpack = fmu._unpacked, fmu._unpacked._unpack
    second = threading.Thread(target=unpacked.acquire)

    def slowly(folder):
        if not second.ident:
            second.start()  # comes while the first one is at it
            second.join(0.2)
        unpack(folder)

    monkeypatch.setattr(unpacked, "_unpack", slowly)
    folder = unpacked.acquire()
    second.join()
    assert [one for one in tmp_path.glob("*/fmu-*")] == [folder]
    unpacked.release()
    assert folder.is_dir()
    unpacked.release()
    assert not list(tmp_path.glob("*/fmu-*"))


def test_where_the_working_directory_was_removed_a_run_still_ends(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    gone = tmp_path / "gone"
    return_to(str(gone))
    assert os.getcwd() == str(tmp_path)


@linux
def test_a_library_that_stands_beside_the_one_that_needs_it_is_found(quirky):
    assert seen(quirky(helped=True))[0] == 42
    assert seen(quirky(helped=True), isolate="process")[0] == 42


@linux
def test_a_library_that_is_nowhere_is_reported(quirky, tmp_path):
    path = repack(
        quirky(helped=True),
        tmp_path / "X.fmu",
        lambda name, data: (name.replace("libhelper", "libother"), data),
    )
    # Another name than above: what a process has loaded once it finds again.
    path = repack(
        path,
        tmp_path / "Y.fmu",
        lambda name, data: (name, data.replace(b"libhelper.so", b"libabsent.so")),
    )
    with pytest.raises(FmuError) as caught:
        load_fmu(path).instantiate("one")
    assert str(caught.value) == (
        f"{path}: needs the library libabsent.so, which is not installed\n  Install it."
    )


def test_log_messages_with_arguments_are_written_out(quirky):
    instance = load_fmu(quirky("talks")).instantiate("one")
    instance.enter_initialisation(0.0, {})
    instance.exit_initialisation()
    instance.do_step(Point(0, 0.25, 0.1))
    lines = instance.log_lines()
    assert lines[0] == "[ok] at 0.25 s: 3 of four,  75.0% done"
    assert lines[1] == "[warning] no environment, no category"
    assert set(lines[2].removeprefix("[ok] ")) == {"x"}  # a long one may be cut, and harms nothing
    instance.free()


def test_warnings_of_every_call_are_no_errors(quirky):
    assert seen(quirky("warns"))[0] == 0


def test_an_error_at_the_end_changes_no_result_and_is_reported(quirky):
    assert seen(quirky("fails at the end"))[1] == {"one": ["[error] fmi2Terminate returned error"]}


@pytest.mark.skipif(os.name != "posix", reason="signals are reported by name on POSIX only")
def test_a_crash_at_the_end_changes_no_result_if_it_is_isolated(quirky):
    log = seen(quirky("dies at the end"), isolate="process")[1]
    assert log["one"][-1] == "[crashed] its process died in terminate: SIGABRT (Aborted)"


ENCODINGS = {
    "utf-8": ("utf-8", "UTF-8"),
    "a byte order mark": ("utf-8-sig", "utf-8"),
    "a byte order mark and no declaration": ("utf-8-sig", ""),
    "utf-16": ("utf-16", "UTF-16"),
    "Latin 1": ("iso-8859-1", "ISO-8859-1"),
    "Windows": ("cp1252", "windows-1252"),
    "no declaration": ("utf-8", ""),
}


@pytest.mark.parametrize("name", ENCODINGS)
def test_model_descriptions_in_any_encoding(name, quirky):
    encoding, declared = ENCODINGS[name]
    path = quirky(encoding=encoding, declared=declared)
    level = load_fmu(path).description.variables["level"]
    assert level.kind is Kind.ENUMERATION and level.items == {"low": -1, "höher": 5}
    made = run(config(path, start={"Verstärkung": 2, "level": "höher"}), halving=False)
    assert made.results["one.y"] == pytest.approx(2.0 * made.results.time)


def test_variables_without_start_values_are_reported_and_run(quirky):
    path = quirky()
    assert load_fmu(path).description.variables["u"].start is None
    notes = prepare(config(path)).system.notes
    assert len(notes) == 1 and "breaks a rule of FMI" in notes[0]
    assert np.isfinite(run(config(path), halving=False).results["one.y"]).all()


def test_optional_functions_may_be_missing(quirky):
    instance = load_fmu(quirky()).instantiate("one")
    absent = {"fmi2GetTypesPlatform", "fmi2SetDebugLogging", "fmi2Reset", "fmi2GetString", "fmi2GetStatus"}
    assert not absent & set(instance._slave._functions)
    instance.free()
    seen(quirky())


def test_an_fmu_that_fails_at_the_end_is_freed(quirky):
    instance = load_fmu(quirky("fails at the end")).instantiate("one")
    instance.enter_initialisation(0.0, {})
    instance.exit_initialisation()
    with pytest.raises(StepError, match="fmi2Terminate returned error"):
        instance.terminate()
    free, freed = instance._slave._functions["fmi2FreeInstance"], []
    instance._slave._functions["fmi2FreeInstance"] = lambda component: freed.append(free(component))
    instance.free()
    assert len(freed) == 1


def test_functions_that_end_things_may_be_missing(quirky):
    def rename(name, data):
        return name, data.replace(b"fmi2Terminate\0", b"fmi2Terminatx\0").replace(
            b"fmi2FreeInstance\0", b"fmi2FreeInstanxe\0"
        )

    path = quirky()
    renamed = repack(path, path.with_name("X.fmu"), rename)
    instance = load_fmu(renamed).instantiate("one")
    instance.enter_initialisation(0.0, {})
    instance.exit_initialisation()
    if "fmi2Terminate" in instance._slave._functions:
        pytest.skip("names of functions are hashed here, which finds them under their old names alone")
    instance.terminate()
    instance.free()
