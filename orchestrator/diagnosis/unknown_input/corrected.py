"""The system with the answer, as a config that runs: each law is a Modelica model and an FMU beside it."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...base.atomic_files import write_text
from ...base.errors import OrchestratorError
from ...config.text import dump
from ...system.connection import Port
from ...translate.build import build
from ...translate.package import this_platform
from ..study.config_data import config_data, long_form, short_form, with_unit
from ..study.study import PortStudy
from .answer import Answer
from .corrected_component import ModelOfLaw, build_corrected
from .evaluation import Kinds
from .law_fit import Candidate


def write_corrected(study: PortStudy, found: Answer, folder: Path) -> list[str]:
    """Write `corrected.yaml` with the calibrated numbers and the laws, and a model and an FMU for each law.

    Returns: what could not be written, and why, in sentences.
    """
    data = config_data(study)
    for name, (value, _) in found.parameters.items():
        port = Port.of(name)
        data["instances"][port.instance]["start"][port.variable] = with_unit(value, study.unit(port))
    connections = [long_form(one) for one in data.get("connections", [])]
    laws = found.fitted.by_law() if found.fitted and found.verdict == "law" else ()
    inside: dict[str, list[ModelOfLaw]] = {}
    for number, (law, values, _) in enumerate(laws, 1):
        name = f"law_{number}"
        if not law.law.modelica:
            return [f"{law.name} is not in corrected.yaml: the law has no Modelica equations."]
        opening = found.openings.get(Port.of(law.place.name))
        series = law.signal == law.place.name and opening is None
        text = _model(law, values.tolist(), name, series, found.units, study.interval)
        if opening is not None:
            port = Port.of(law.place.name)
            before = f"{port.instance}.{opening.before}"
            reads = _reads(before if law.signal == law.place.name else law.signal, law.second)
            made = ModelOfLaw(name, text, {}, reads, opening=port.variable)
            inside.setdefault(port.instance, []).append(made)
            continue
        if law.place.kind in (Kinds.RATE, Kinds.EXCHANGE):
            exchange = law.place.kind is Kinds.EXCHANGE
            if exchange and math.isnan(law.place.ratio):
                return [
                    f"corrected.yaml is not written: {law.name} is shared by capacities that change with the "
                    f"states. Add the flow to the equations of both states; the number is that of "
                    f"der({law.signal}) at the config's start values and parameters, what passes counts "
                    f"from {law.signal}."
                ]
            state = Port.of(law.signal if exchange else law.place.name.removeprefix("der(").removesuffix(")"))
            reads = _reads(law.signal, law.second)
            shares = {state.variable: 1.0}
            if exchange:
                shares = {state.variable: -1.0, Port.of(law.second).variable: law.place.ratio}
            inside.setdefault(state.instance, []).append(ModelOfLaw(name, text, shares, reads))
            continue
        ports = [Port.of(one) for one in (law.place.name, law.signal, law.second) if one]
        problem = _put(study, data, connections, law, name)
        own = len({one.instance for one in ports}) == 1 and law.signal != law.place.name
        if problem and own and law.place.kind is Kinds.INPUT:
            # What it reads is inside the component, and so may the law be.
            reads = _reads(law.signal, law.second)
            made = ModelOfLaw(name, text, {}, reads, ports[0].variable)
            inside.setdefault(ports[0].instance, []).append(made)
            continue
        problem = problem or _built(text, name, folder)
        if problem:
            return [f"{law.name} is not in corrected.yaml: {problem}"]
    for instance, models in inside.items():
        path, problem = build_corrected(study.prepared.system, instance, models, folder)
        if problem:
            names = ", ".join(
                f"{one.name} at {place}"
                for one in models
                for place in (
                    [f"der({instance}.{state})" for state in one.shares]
                    or [f"{instance}.{one.input or one.opening}"]
                )
            )
            return [f"corrected.yaml is not written: a law acts inside a component, {names}; {problem}"]
        data["instances"][instance]["fmu"] = path
    short = [short_form(one) for one in connections]
    data["connections"] = [
        {key: value for key, value in one.items() if value != []} if isinstance(one, dict) else one
        for one in short
    ]
    data["title"] = f"{data.get('title', study.prepared.config.name)}, corrected by its logs"
    write_text(folder / "corrected.yaml", dump(data))
    return []


def _reads(signal: str, second: str) -> dict[str, str]:
    """The component's variables for the inputs u and v of a law's model."""
    return {key: Port.of(one).variable for key, one in (("u", signal), ("v", second)) if one}


def _put(
    study: PortStudy, data: dict[str, Any], connections: list[dict[str, Any]], law: Candidate, name: str
) -> str:
    """Add the law's instance and its connections; why that cannot be, or "".

    A law of the signal at its own place stands in series; the others add to the signal at their place.
    """
    place = law.place.name
    series = law.signal == place
    read, problem = _source(study, connections, law.signal, f"{name}.u")
    second, other = _source(study, connections, law.second, f"{name}.v") if law.second else (None, "")
    problem = other or ("" if series else problem)
    if problem:
        return problem
    if second is not None:
        connections.append(second)
    data["instances"][name] = {"fmu": f"{name}.fmu"}
    if law.place.kind is Kinds.INPUT:
        port = Port.of(place)
        constant = float(study.prepared.system.start(port))
        data["instances"][port.instance]["start"].pop(port.variable, None)
        feeding = next((one for one in connections if one["to"] == place), None)
        if series:
            if feeding is not None:
                connections.append({**feeding, "to": f"{name}.u"})
                connections.remove(feeding)
            else:
                data["instances"][name]["start"] = {"u": with_unit(constant, study.unit(port))}
            connections.append(long_form(f"{name}.y -> {place}"))
            return ""
        if feeding is None:
            added = long_form(f"{name}.y -> {place}")
            if constant:
                added["through"] = [{"offset": with_unit(constant, study.unit(port))}]
            connections.append(added)
        else:
            feeding["from"] = [*feeding["from"], {"port": f"{name}.y"}]
    else:
        readers = [one for one in connections if any(leg["port"] == place for leg in one["from"])]
        for one in readers:
            for leg in [leg for leg in one["from"] if leg["port"] == place]:
                if series:
                    leg["port"] = f"{name}.y"
                else:
                    one["from"] = [*one["from"], {**leg, "port": f"{name}.y"}]
        if not readers and not series:
            return f"nothing reads {place}."
    connections.append(long_form(f"{place} -> {name}.u") if series or read is None else read)
    return ""


def _source(
    study: PortStudy, connections: list[dict[str, Any]], signal: str, to: str
) -> tuple[dict[str, Any] | None, str]:
    """A connection that leads a signal to a port, or why there is none."""
    read = next((one for one in connections if one["to"] == signal), None)
    if read is not None:
        return {**read, "to": to}, ""
    if signal not in {str(port) for port in study.prepared.system.recorded}:
        return None, f"it reads {signal}, which is neither an output nor connected to one."
    return long_form(f"{signal} -> {to}"), ""


def _model(
    law: Candidate, values: list[float], name: str, series: bool, units: Mapping[str, str], interval: float
) -> str:
    """The text of the law's model.

    Args:
        series: whether its output takes the place of the signal. interval: of the logs [s].
    """
    read = units[law.signal]
    rate = law.place.kind in (Kinds.RATE, Kinds.EXCHANGE)
    unit = "" if rate else f'(unit="{units[law.place.name]}")'
    second = law.second and (f'  input Real v(unit="{units[law.second]}", start=0) "Second signal";\n')
    code, declared = law.law.modelica, []
    for number, value in zip(law.law.numbers, values, strict=True):
        declared.append(f'  parameter Real {number.word} = {value!r} "{number.name}";')
    if re.search(r"\binterval\b", code):
        declared.append(f'  parameter Real interval = {interval!r} "Interval of the logs";')
    states = [k for k in range(law.law.states) if f"z{k + 1}" in code]
    settled = [k for k in law.law.settled if k in states]
    declared += [f"  Real z{k + 1}{'' if k in settled else '(start=0, fixed=true)'};" for k in states]
    begin = "".join(f"initial equation\n  z{k + 1} = u;\n" for k in settled)
    if series:
        code = code.replace("y =", "added =")
        declared.append("  Real added;")
        code += " y = u + added;"
    return (
        f'model {name} "{law.law.sentence.rstrip(".")}"\n' + "\n".join(declared) + "\n"
        f'  input Real u(unit="{read}", start=0) "Signal that the law reads";\n'
        f"{second}"
        f'  output Real y{unit} "{"Signal with the law" if series else "What the law adds"}";\n'
        f"{begin}equation\n" + "".join(f"  {one.strip()};\n" for one in code.split(";") if one.strip())
        + f"end {name};\n"
    )  # fmt: skip


def _built(text: str, name: str, folder: Path) -> str:
    """Write a law's model and build its FMU; why that failed, or ""."""
    model = folder / f"{name}.mo"
    write_text(model, text)
    try:
        build(model, folder / f"{name}.fmu", platforms=[this_platform()])
    except (OrchestratorError, ImportError) as error:
        return f"{model.name} is written, but its FMU could not be built: {str(error).splitlines()[0]}"
    return ""
