"""Checks with calls and values that an FMU should refuse: it may not crash or hang, and should say so."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ...base.errors import FmuError, StepError
from ...fmi import Causality, Interface, Kind, StepStatus, Variability
from ...fmi.loading import load_fmu
from .finding import Finding, Level, Verdict, failed, passed
from .trial import Ended, Trial

_NOWHERE = 4_294_967_290


def _before_initialisation(trial: Trial, instance: Any) -> StepStatus:
    return instance.do_step(trial.point(0))


def _after_terminate(trial: Trial, instance: Any) -> StepStatus:
    trial.initialise(instance, trial.rows)
    trial.drive(instance, trial.rows, 0, 1)
    instance.terminate()
    return instance.do_step(trial.point(1))


def _initialise_twice(trial: Trial, instance: Any) -> None:
    trial.initialise(instance, trial.rows)
    instance.enter_initialisation(0.0, {})


def _set_fixed_parameter(trial: Trial, instance: Any) -> None:
    name = next(
        one.name
        for one in trial.description.parameters
        if one.variability is Variability.FIXED and one.kind is Kind.REAL and not one.shape
    )
    trial.initialise(instance, trial.rows)
    value = instance.get_values([name])[name]
    trial.drive(instance, trial.rows, 0, 1)
    instance.set_values({name: value})


def _set_output(trial: Trial, instance: Any) -> None:
    name = next(
        one.name
        for one in trial.description.outputs
        if one.kind is Kind.REAL and not one.shape and one.elements == 1
    )
    trial.initialise(instance, trial.rows)
    instance.set_values({name: 0.0})


def _unknown_reference(trial: Trial, instance: Any) -> None:
    trial.initialise(instance, trial.rows)
    known = next(
        one
        for one in trial.description.variables.values()
        if one.kind is Kind.REAL and not one.shape and one.causality is not Causality.INDEPENDENT
    )
    unknown = replace(known, name="nowhere", reference=_NOWHERE, elements=1, element=0)
    instance.description = replace(
        trial.description, variables={**trial.description.variables, "nowhere": unknown}
    )
    instance.get_values(["nowhere"])


def _backward_step(trial: Trial, instance: Any) -> StepStatus:
    trial.initialise(instance, trial.rows)
    trial.drive(instance, trial.rows, 0, 2)
    return instance.do_step(trial.point(2)._replace(step_size=-trial.step))


# What is asked for -> how; StopIteration where the FMU has nothing to ask it of.
_CALLS: dict[str, Callable[[Trial, Any], Any]] = {
    "a step before initialisation": _before_initialisation,
    "a step after termination": _after_terminate,
    "a second initialisation": _initialise_twice,
    "setting a fixed parameter between steps": _set_fixed_parameter,
    "setting an output": _set_output,
    "a step backwards": _backward_step,
    "reading a value reference that does not exist": _unknown_reference,
}


def _checker(what: str, call: Callable[[Trial, Any], Any]) -> Callable[[Trial], Finding]:
    def check(trial: Trial) -> Finding:
        name = f"refuses {what}"
        if trial.description.fmi_version == "1.0" or trial.description.interface is Interface.MODEL_EXCHANGE:
            return Finding(name, Verdict.NOT_APPLICABLE, "It is tried with co-simulation of FMI 2 and 3.")
        with trial.made() as instance:
            try:
                status = call(trial, instance)
            except StopIteration:
                return Finding(name, Verdict.NOT_APPLICABLE, "The FMU has no such variable.")
            except StepError as error:
                return passed(name, f"It is refused ({error.what}).")
            except Ended as end:
                return passed(name, f"It is refused ({end}).")
        if isinstance(status, StepStatus) and status > StepStatus.WARNING:
            return passed(name, f"It is refused ({status.name.lower()}).")
        return failed(
            name,
            Level.WARNING,
            f"{what[0].upper()}{what[1:]} is answered as if it were legal.",
            "Return an error, so that a master's mistake shows.",
        )

    return check


ILLEGAL = {f"refuses {what}": _checker(what, call) for what, call in _CALLS.items()}


def wrong_token(trial: Trial) -> Finding:
    """A description of another build is noticed at instantiation."""
    check = "refuses a wrong token"
    fmu = load_fmu(trial.fmu.path, trial.fmu.run_options)
    other = type(fmu).__new__(type(fmu))
    other.__dict__.update(fmu.__dict__)
    other.description = replace(fmu.description, token="{00000000-0000-0000-0000-000000000000}")
    try:
        other.instantiate("one").free()
    except FmuError as error:
        return passed(check, f"It is refused ({str(error).splitlines()[-1].strip()}).")
    remedy = "Compare it: value references of another build of the model mean other variables."
    if _by_pythonfmu(trial):
        remedy = (
            "pythonfmu's binary neither compares it nor hands it on to the model's Python code, so that this "
            "FMU cannot; a native form can (orchestrator build model.py --form native)."
        )
    return failed(check, Level.WARNING, "An instance is made although the token is not the FMU's.", remedy)


def _by_pythonfmu(trial: Trial) -> bool:
    with zipfile.ZipFile(trial.fmu.path) as archive:
        return "resources/slavemodule.txt" in archive.namelist()


def _fed(check: str, trial: Trial, value: float) -> Finding:
    if not trial.reals:
        return Finding(check, Verdict.NOT_APPLICABLE, "The FMU has no real inputs.")
    rows = trial.rows.copy()
    bad = min(3, len(rows) - 1)
    for name in trial.reals:
        rows[bad:, trial.inputs.index(name)] = value
    with trial.made() as instance:
        trial.initialise(instance, rows)
        before = trial.drive(instance, rows, 0, bad)
        try:
            seen = trial.drive(instance, rows, bad)
        except StepError as error:
            return passed(check, f"They are refused ({error.what}).")
        except Ended as end:
            return passed(check, f"They are refused ({end}).")
    if not np.isfinite(seen).all():
        return passed(check, "They are taken, and show in outputs that are not finite.")
    if np.isnan(value) and not (seen == before[-1]).all():
        return failed(
            check,
            Level.WARNING,
            "They are taken, and every output stays finite: whoever feeds them will not notice.",
            "Return an error, or let NaN through to the outputs.",
        )
    return passed(check, "They are taken, and every output stays finite.")


def nan_inputs(trial: Trial) -> Finding:
    """NaN at every real input is refused, or shows at the outputs."""
    return _fed("NaN inputs", trial, float("nan"))


def infinite_inputs(trial: Trial) -> Finding:
    """Infinite inputs end in an error or in values, not in a crash."""
    return _fed("infinite inputs", trial, float("inf"))
