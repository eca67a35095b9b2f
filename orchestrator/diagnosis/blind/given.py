"""Hide laws in a system of FMUs: SciPy integrates the derivatives that the FMUs give."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.errors import ConfigError, Problem
from ...config.text import dump
from ...fmi import Causality, Kind
from ...simulation.run import prepare
from ...system.connection import Port
from ..study.keys import Logged
from ..study.reader import load_port_study
from ..study.study import Nominal, PortStudy, is_port_study
from ..unknown_input.model import StateModel, acts_of, evaluate
from .cases import RUNS, Draft, driven
from .plant import Acting, Drive

__all__ = ["Given", "given"]

Array = NDArray[np.float64]
# Laws that act on one another are evaluated so often.
_PASSES = 3
# Of a config without a study: tolerance of parameters, spread of start values, samples until its stop time.
_TOLERANCE, _VARIED, _SAMPLES = 0.02, 0.05, 500
# No law of the search acts here.
_NOTHING, _NONE = acts_of((), None, 0.0)
_ZEROS = np.zeros(1)
_MEMORY = np.zeros((0, 0, 3)), np.zeros(4), np.zeros((2, 8))


@dataclass
class Given:
    """A system of FMUs as a `Plant`; to be closed.

    A law's w is added to constants of inputs, to what drives them, or to derivatives. The law itself, the
    drive and the integration are those of random systems.
    """

    study: PortStudy
    file: Path
    is_study: bool
    units: dict[str, str] = field(default_factory=dict)
    legs: dict[str, list[tuple[str, float]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.model = model = StateModel(self.study)
        self.states, self.inputs, self.outputs, self.parameters = (
            [str(one) for one in ports]
            for ports in (model.states, model.inputs, model.outputs, model.parameters)
        )
        self.external = [str(one) for one in model.fed]
        self.compared = [str(one) for one in model.compared]
        self.start, self.nominal = model.start.copy(), model.nominal.copy()
        ports = (*model.states, *model.inputs, *model.outputs, *model.parameters)
        self.units = {str(one): self.study.unit(one) for one in ports}
        first, source, gain = model.wiring[:3]
        self.legs = {
            name: [(self.outputs[source[k]], float(gain[k])) for k in range(first[i], first[i + 1])]
            for i, name in enumerate(self.inputs) if first[i + 1] > first[i]
        }  # fmt: skip
        self._constant = model.wiring[3].copy()
        self._readers: dict[str, list[tuple[int, float]]] = {one: [] for one in self.outputs}
        for name, legs in self.legs.items():
            for output, factor in legs:
                self._readers[output].append((self.inputs.index(name), factor))
        self._scratch = [np.zeros(len(one)) for one in (self.inputs, self.outputs, self.states)]

    def close(self) -> None:
        """Free the FMUs."""
        self.model.__exit__()

    def evaluate(
        self, t: float, x: Sequence[float], e: Sequence[float], p: Sequence[float],
        laws: Sequence[Acting], z: Sequence[float],
    ) -> tuple[list[float], list[float], list[float]]:  # fmt: skip
        """See `Plant`."""
        model, acting = self.model, [one for one in laws if not one.delay]
        u, y, rate = self._scratch
        constant, nx, nu = model.wiring[3], len(x), len(self.inputs)
        w, extra = [0.0] * len(acting), [0.0] * len(z)
        state, numbers = np.array(x, float), np.array(p, float)
        made: list[float] = []
        for _ in range(_PASSES if acting else 1):
            fed = np.array(e, float)
            constant[:] = self._constant
            for law, value in zip(acting, w, strict=True):
                if law.place in self.external:
                    fed[self.external.index(law.place)] += value
                elif law.kind == "input":
                    constant[law.index] += value
                elif law.kind == "output":
                    for i, gain in self._readers[law.place]:
                        constant[i] += gain * value
            evaluate(model.rows, model.wiring, state, fed, numbers, t, _NOTHING, 0.0, _NONE, _ZEROS, _ZEROS,
                     u, y, rate, _ZEROS, *_MEMORY)  # fmt: skip
            made = [*x, *u.tolist(), *y.tolist()]
            at = 0
            for k, law in enumerate(acting):
                read = [made[j] for j in law.reads]
                if law.kind == "input" and law.reads == (nx + law.index,):
                    read[0] -= w[k]
                mine = z[at : at + law.states]
                if law.rate is not None:
                    extra[at : at + law.states] = law.rate(t, read, mine)
                w[k] = law.value(t, read, mine)
                at += law.states
        found = rate.tolist()
        for law, value in zip(acting, w, strict=True):
            if law.kind == "output":
                made[nx + nu + law.index] += value
            elif law.kind == "rate":
                found[law.index] += value
        return found, extra, made

    def draft(self, random: np.random.Generator) -> Draft:
        """What drives the copy: the study's own logs, or tones and steps of the size of start values."""
        model, study = self.model, self.study
        calibrated = [(k, float(one)) for k, one in enumerate(model.tolerance)]
        if self.is_study:
            made = []
            for run in study.runs:
                ext, held = model.external(run)
                made.append(Drive(np.ascontiguousarray(ext), bool(held.any()), study.interval))
            names = [(one.name, one.role.value) for one in study.runs]
            return Draft(self, lambda again: made, calibrated, model.noise, 0.0, study.name, names)
        steps = bool(random.random() < 0.4)
        means = [study.prepared.system.start(one) for one in model.fed]

        def drives(again: np.random.Generator) -> list[Drive]:
            columns = [
                np.column_stack([driven(again, count, steps, mean, abs(mean) or 1.0) for mean in means])
                if means else np.zeros((count, 0))
                for *_, count in RUNS
            ]  # fmt: skip
            return [Drive(one, steps, study.interval) for one in columns]

        varied = _VARIED if means else 0.5
        return Draft(
            self, drives, calibrated, None, varied, study.name, [(name, role) for name, role, _ in RUNS]
        )

    def write_system(self, folder: Path) -> None:
        """Write system.yaml, with FMUs named from there."""
        config = self.study.prepared.config
        data = config.model.to_data()
        for one in data["instances"].values():
            if (config.folder / one["fmu"]).is_file():
                one["fmu"] = str((config.folder / one["fmu"]).resolve())
        (folder / "system.yaml").write_text(dump(data), encoding="utf-8")


def given(path: Path) -> Given:
    """A system that laws can be hidden in: a study of ports, or a config.

    Of a config, inputs that nothing drives are driven, outputs that nothing reads are compared (all, where
    every one is read), and parameters that it gives are calibrated to 2 %.

    Raises: ConfigError if components give no access to their states, or connections have memory.
    """
    if is_port_study(path):
        return Given(load_port_study(path), path, True)
    prepared = prepare(path, ["run.record=all"])
    system = prepared.system
    driven_ports = {one.target for one in system.connections}
    read = {leg for one in system.connections for leg in _sources(one)}
    fed, compared, nominal = list[Port](), list[Port](), dict[str, Nominal]()
    parts = max(1, round(prepared.grid.steps / _SAMPLES))
    for one in system.instances:
        for name, variable in one.fmu.description.variables.items():
            port = Port(one.name, name)
            if variable.kind is not Kind.REAL:
                continue
            if variable.causality is Causality.INPUT and port not in driven_ports:
                fed.append(port)
            elif variable.causality is Causality.OUTPUT:
                compared.append(port)
            elif variable.causality is Causality.PARAMETER and name in one.start and system.start(port):
                nominal[str(port)] = Nominal(system.start(port), _TOLERANCE * abs(system.start(port)))
    compared = [one for one in compared if one not in read] or compared
    if not compared:
        raise ConfigError(
            [Problem(str(path), "no component has a real output", "", "Name a study of its ports.")]
        )
    columns: Mapping[Port, Any] = {
        port: Logged(column=str(port), noise=1.0 if port in compared else None) for port in (*fed, *compared)
    }
    study = PortStudy(path.stem, prepared, columns, tuple(fed), tuple(compared), nominal, 0, (), parts=parts)
    return Given(study, path, False)


def _sources(connection: Any) -> list[Port]:
    if connection.wire is None:
        return [connection.source]
    return [leg.port for leg in connection.wire.legs]
