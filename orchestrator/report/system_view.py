"""A system as Python code has it: loaded or built step by step, checked, drawn, written as YAML, run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from ..base.errors import listed, nearest
from ..base.text_tables import html_table
from ..config import Config, load_config
from ..config.files import rebase
from ..config.text import copied, dump
from ..fmi import Causality
from ..simulation.preparation import Prepared, prepare
from ..system.si_numbers import in_config_units
from ..translate.linear_model import is_linear, kept_fmu
from .graph_svg import draw_graph


@dataclass(frozen=True)
class ParameterView:
    """A parameter or start value of an instance: its value in the FMU's unit."""

    value: Any
    unit: str
    description: str = ""

    def __repr__(self) -> str:
        value = f"{self.value:.6g}" if isinstance(self.value, float) else str(self.value)
        return value if self.unit in ("", "1") else f"{value} {self.unit}"


@dataclass(frozen=True, repr=False)
class InstanceView:
    """An instance of a system.

    Attributes:
        name: in the system.
        model: name of the FMU's model.
        fmu: path of the FMU; None if it is no file.
        parameters: by name, with their values in this system.
        inputs, outputs: unit of each by name.
    """

    name: str
    model: str
    fmu: Path | None
    parameters: Mapping[str, ParameterView]
    inputs: Mapping[str, str]
    outputs: Mapping[str, str]

    def __repr__(self) -> str:
        return f"{self.name}: {self.model}, inputs {listed(self.inputs)}, outputs {listed(self.outputs)}"

    def _repr_html_(self) -> str:
        rows = [("parameter", name, repr(one)) for name, one in self.parameters.items()]
        rows += [("input", name, unit) for name, unit in self.inputs.items()]
        rows += [("output", name, unit) for name, unit in self.outputs.items()]
        return f"<b>{escape(self.name)}</b>: {escape(self.model)}{html_table(rows)}"


class _Instances(Mapping[str, InstanceView]):
    def __init__(self, views: Mapping[str, InstanceView]) -> None:
        self._views = views

    def __getitem__(self, name: str) -> InstanceView:
        if name not in self._views:
            what = f"no instance {name!r}; there are {listed(self._views)}. {nearest(name, self._views)}"
            raise KeyError(what.strip())
        return self._views[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._views)

    def __len__(self) -> int:
        return len(self._views)

    def __repr__(self) -> str:
        return "\n".join(map(repr, self._views.values()))


class SystemGraph:
    """The drawing of a system: instances, and connections with their units and effects."""

    def __init__(self, svg: str) -> None:
        self.svg = svg

    def save(self, path: Path | str) -> None:
        """Write the drawing as an SVG file."""
        Path(path).write_text(self.svg, encoding="utf-8")

    def _repr_svg_(self) -> str:
        return self.svg

    def __repr__(self) -> str:
        return f"SystemGraph: {len(self.svg)} characters of SVG"


class System:
    """A system of connected FMUs.

    `orchestrator.load` makes one of a config; `System(step_size=..., stop_time=...)` begins an empty one, to
    which `add` and `connect` add. `orchestrator.run(system)` runs it. Nothing is checked before that, or
    before `check` or `instances`, which raise ConfigError with all problems.
    """

    def __init__(
        self,
        *,
        step_size: str | float | None = None,
        stop_time: str | float | None = None,
        start_time: str | float = 0.0,
        master: str | Mapping[str, Any] = "gauss-seidel",
        title: str = "",
    ) -> None:
        """
        Args:
            step_size, stop_time, start_time: texts with a unit such as "1 ms", or numbers [s].
            master: its name, or its name and options: {"name": "iterative", "tolerance": 1e-8}.
            title: for figures and reports.
        """
        times = {"step_size": step_size, "stop_time": stop_time, "start_time": start_time}
        run: dict[str, Any] = {key: value for key, value in times.items() if value is not None}
        self._data: dict[str, Any] = {"title": title} if title else {}
        self._data["run"] = run | {"master": master if isinstance(master, str) else dict(master)}
        self._data |= {"instances": {}, "connections": []}
        self._prepared: Prepared | None = None
        self._config: Config | None = None

    @classmethod
    def of(cls, source: str | Path | Mapping[str, Any] | Config) -> System:
        """The system of a config.

        Args:
            source: name of a bundled system, path of a .yaml, .fmu, .ssp or .ssd file, plain values.
        Raises: ConfigError with all problems.
        """
        config = load_config(source)
        system = cls()
        system._data = config.model.to_data()
        rebase(system._data, config.folder, Path.cwd() / "elsewhere")
        system._config = config
        return system

    def add(
        self, name: str, fmu: str | Path | Any, *, step_size: str | float | None = None, **start: Any
    ) -> System:
        """Add an instance.

        Args:
            name: of the instance.
            fmu: name of a bundled FMU, or path of a .fmu or .csv file; or a linear system of python-control
                or scipy; its FMU is built and kept in this user's cache. See `orchestrator.build`.
            step_size: its own step size; None: the system's.
            start: parameters and start values: plain numbers in SI units, or texts with a unit. Names that
                Python cannot take as keywords can be given as `**{"x[1]": 2.0}`.
        Returns: the system itself.
        Raises: ConfigError, BuildError if no FMU can be built of a linear system.
        """
        instance: dict[str, Any] = {}
        if is_linear(fmu):
            fmu, feedthrough = kept_fmu(fmu)
            instance |= {"feedthrough": feedthrough} if feedthrough else {}
        instance["fmu"] = str(fmu)
        if step_size is not None:
            instance["step_size"] = step_size
        if start:
            instance["start"] = dict(start)
        return self._changed("instances", name, instance)

    def connect(self, source: str | Sequence[Any], target: str, *through: Mapping[str, Any]) -> System:
        """Add a connection.

        Args:
            source: "instance.output", or several, which are added.
            target: "instance.input".
            through: effects on the way, such as {"delay": "3 ms"} or {"delay": 0.003}.
        Returns: the system itself.
        """
        plain = isinstance(source, str) and not through
        link: Any = f"{source} -> {target}" if plain else {"from": source, "to": target}
        if through:
            link["through"] = [dict(one) for one in through]
        return self._changed("connections", None, link)

    def _changed(self, section: str, name: str | None, value: Any) -> System:
        if name is None:
            self._data.setdefault(section, []).append(value)
        else:
            self._data.setdefault(section, {})[name] = value
        self._prepared = self._config = None
        return self

    @property
    def data(self) -> dict[str, Any]:
        """The config as plain values, a copy. Raises: ConfigError if it has not the form of one."""
        return in_config_units(self._data) if self._config is None else copied(self._data)

    def check(self) -> Prepared:
        """Check config, FMUs, connections, master and times. Raises: ConfigError with all problems."""
        if self._prepared is None:
            self._prepared = prepare(self.data if self._config is None else self._config)
        return self._prepared

    @property
    def instances(self) -> Mapping[str, InstanceView]:
        """The instances by name. Raises: ConfigError if the system is not right."""
        return _Instances({one.name: _view(one) for one in self.check().system.instances})

    @property
    def connections(self) -> tuple[str, ...]:
        """The connections, one text each. Raises: ConfigError if the system is not right."""
        return tuple(str(one) for one in self.check().system.connections)

    def graph(self) -> SystemGraph:
        """The system as a drawing. Raises: ConfigError if it is not right, ValueError if it is too large."""
        prepared = self.check()
        ports = [(one, name) for one in prepared.system.instances for name in one.fmu.description.variables]
        units = {f"{one.name}.{name}": one.variable(name).unit_name for one, name in ports}
        drawn = draw_graph(prepared.config.model, units)
        if not drawn:
            raise ValueError(f"{len(prepared.system.instances)} instances are too many to be drawn")
        return SystemGraph(drawn)

    def to_yaml(self, path: Path | str | None = None) -> str:
        """The config as YAML text; also written to `path` if one is given."""
        text = dump(self.data)
        if path is not None:
            Path(path).write_text(text, encoding="utf-8")
        return text

    def __repr__(self) -> str:
        kinds = ", ".join(f"{name} ({one['fmu']})" for name, one in self._data.get("instances", {}).items())
        title = self._data.get("title") or "System"
        return f"{title}: {kinds or 'no instances'}; {len(self._data.get('connections', ()))} connections"

    def _repr_html_(self) -> str:
        rows = html_table((name, one["fmu"]) for name, one in self._data.get("instances", {}).items())
        links = "".join(f"<li>{escape(str(one))}</li>" for one in self._data.get("connections", ()))
        return f"<b>{escape(self._data.get('title') or 'System')}</b>{rows}<ul>{links}</ul>"


def _view(instance: Any) -> InstanceView:
    description = instance.fmu.description
    ports: dict[Causality, dict[str, str]] = {Causality.INPUT: {}, Causality.OUTPUT: {}}
    parameters: dict[str, ParameterView] = {}
    for name, variable in description.variables.items():
        if variable.causality in ports:
            ports[variable.causality][name] = variable.unit_name
        elif (
            variable.causality in (Causality.PARAMETER, Causality.STRUCTURAL_PARAMETER)
            or name in instance.start
        ):
            value = instance.start.get(name, variable.start)
            parameters[name] = ParameterView(value, variable.unit_name, variable.description)
    return InstanceView(
        instance.name,
        description.name,
        instance.fmu.path,
        parameters,
        ports[Causality.INPUT],
        ports[Causality.OUTPUT],
    )
