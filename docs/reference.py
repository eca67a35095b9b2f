"""Reference tables of the documentation site, made from the code: config keys, commands, Python API.

A page names one with a line `<!-- reference: NAME -->`. The site has the text of `PAGES[NAME]()` there.
"""

from __future__ import annotations

import argparse
import base64
import inspect
import io
import re
import types
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib import import_module
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import numpy as np
import yaml
from matplotlib.figure import Figure
from pydantic import BaseModel
from pydantic.fields import FieldInfo

import orchestrator
from orchestrator.campaign import models as study_models
from orchestrator.cli.main import COMMANDS, make_parser
from orchestrator.config import external, models
from orchestrator.diagnosis.unknown_input.laws import Law, domains
from orchestrator.effects.base import OfSignal, Pure
from orchestrator.effects.choose import BUILT_IN, built_in
from orchestrator.master.base import master_class, master_names
from orchestrator.results.measures import measure_class, measure_names

__all__ = ["PAGES", "on_page_markdown"]

# Place in a config -> the model of what stands there.
_SECTIONS: dict[str, type[BaseModel]] = {
    "Top level": models.SystemModel,
    "run": models.RunModel,
    "run.realtime": external.RealtimeModel,
    "instances.NAME": models.InstanceModel,
    "connections[]": models.ConnectionModel,
    "connections[].from[]": models.SourceModel,
    "external.NAME": external.ExternalModel,
    "external.NAME.receive.NAME": external.ReceivedModel,
    "bonds[]": models.BondModel,
}
_STUDY_SECTIONS: dict[str, type[BaseModel]] = {
    "Top level of a study": study_models.StudyModel,
    "design": study_models.BlockModel,
    "design.grid.PATH": study_models.RangeModel,
    "design.random": study_models.SampleModel,
    "design.random.over.PATH": study_models.DrawnModel,
    "design.random.over.PATH.normal": study_models.NormalModel,
    "repeats": study_models.RepeatsModel,
    "record": study_models.RecordModel,
    "retry": study_models.RetryModel,
}
# Types that public functions return, beside those that are exported.
_RETURNED = (
    "orchestrator.campaign.sweep:Swept",
    "orchestrator.frequency.from_system:Linearised",
    "orchestrator.frequency.linear_config:LinearConfig",
    "orchestrator.frequency.delay_system:DelaySystem",
    "orchestrator.frequency.modes:Modes",
    "orchestrator.frequency.modes:Mode",
    "orchestrator.frequency.margins:Margins",
    "orchestrator.frequency.open_loop:OpenLoop",
    "orchestrator.frequency.chart_report:Chart",
    "orchestrator.frequency.describing:LimitCycle",
    "orchestrator.translate.build_report:BuildReport",
    "orchestrator.diagnosis.rig.diagnosed:Diagnosed",
    "orchestrator.diagnosis.unknown_input.diagnose:DiagnosedSystem",
    "orchestrator.report.system_view:InstanceView",
    "orchestrator.report.system_view:ParameterView",
    "orchestrator.report.system_view:SystemGraph",
)
_SIMPLE = {
    str: "text",
    int: "integer",
    float: "number",
    bool: "true or false",
    Any: "any value",
    type(None): "none",
}
_ALIASES = {models.StartValue: "value or array of values"}
_BOUNDS = {
    "ge": "at least {}",
    "gt": "above {}",
    "le": "at most {}",
    "lt": "below {}",
    "min_length": "{} or more entries",
}


def config_keys() -> str:
    """All keys of a config, of masters, effects and measures."""
    parts = list(_tables(_SECTIONS))
    parts.append("## Masters\n\nOptions of `run.master`, beside `name`.")
    for name in master_names():
        parts += _section(f"master {name}", master_class(name), level=3)
    parts.append(
        "## Effects\n\nEntries of `connections[].through`. An option whose unit is that of the signal takes "
        "any unit of the same dimension."
    )
    for name in BUILT_IN:
        parts += _section(f"effect {name}", built_in(name), level=3)
    parts.append("## Measures\n\nEntries of `measures`.")
    for name in measure_names():
        parts += _section(f"measure {name}", measure_class(name).options, level=3)
    return "\n\n".join(parts)


def study_keys() -> str:
    """All keys of the study file of a sweep."""
    return "\n\n".join(_tables(_STUDY_SECTIONS))


def _tables(sections: Mapping[str, type[BaseModel]]) -> Iterator[str]:
    for name, model in sections.items():
        yield from _section(name if " " in name else f"`{name}`", model)


def _section(name: str, model: type[BaseModel], level: int = 2) -> list[str]:
    """Heading, first line of the docstring, and table of a model."""
    rows = [_key_row(key, field) for key, field in model.model_fields.items() if not field.exclude]
    table = _table(("key", "type", "unit", "default", "meaning"), rows)
    first = inspect.cleandoc(model.__doc__ or "").partition("\n\n")[0].replace("\n", " ")
    return [f"{'#' * level} {name}", first, *([table] if rows else ["It has no options."])]


def _key_row(key: str, field: FieldInfo) -> tuple[str, ...]:
    default = "required"
    if not field.is_required():
        value = field.get_default(call_default_factory=True)
        default = _value(value) if value not in ({}, [], (), "") else "empty"
    meaning = field.description or ""
    bounds = [
        words.format(getattr(mark, name))
        for mark in field.metadata
        for name, words in _BOUNDS.items()
        if getattr(mark, name, None) is not None
    ]
    if bounds:
        meaning += f" Allowed: {', '.join(bounds)}."
    marks = [one for one in (*field.metadata, *_marks(field.annotation)) if isinstance(one, Pure | OfSignal)]
    # The example of a time is the same everywhere.
    if field.examples and not marks:
        meaning += f" Example: {_value(field.examples[0])}."
    kind = "quantity" if marks else _type(field.annotation)
    return f"`{field.alias or key}`", kind, _unit(marks), default, meaning.strip()


def _marks(annotation: Any) -> Iterator[Any]:
    """The marks of an annotation, those of a union's members included."""
    if get_origin(annotation) is Annotated:
        yield from annotation.__metadata__
    elif get_origin(annotation) in (Union, types.UnionType):
        for one in get_args(annotation):
            yield from _marks(one)


def _unit(marks: Iterable[Pure | OfSignal]) -> str:
    for mark in marks:
        if isinstance(mark, Pure):
            return mark.unit
        return f"of the signal, per {mark.per}" if mark.per else "of the signal"
    return ""


def _type(annotation: Any) -> str:
    """A type in words."""
    if annotation in _ALIASES:
        return _ALIASES[annotation]
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _type(arguments[0])
    if origin in (Union, types.UnionType):
        if set(get_args(models.Scalar)) <= set(arguments):
            rest = [_type(one) for one in arguments if one not in (*get_args(models.Scalar), type(None))]
            return " or ".join(["value", *rest])
        return " or ".join(dict.fromkeys(_type(one) for one in arguments if one is not type(None)))
    if origin is Literal:
        return ", ".join(f"`{one}`" for one in arguments)
    if origin in (list, tuple):
        return f"list of {_type(arguments[0])}"
    if origin is dict:
        return f"mapping of name to {_type(arguments[1])}"
    if inspect.isclass(annotation) and issubclass(annotation, BaseModel):
        sections = {**_SECTIONS, **_STUDY_SECTIONS}
        return next(
            (f"[{name}](#{_anchor(name)})" for name, one in sections.items() if one is annotation), "mapping"
        )
    return _SIMPLE.get(annotation, str(annotation))


def _anchor(name: str) -> str:
    return re.sub(r"\s", "-", re.sub(r"[^\w\s-]", "", name).strip().lower())


def _value(value: Any) -> str:
    """A value as it stands in YAML."""
    if value is None:
        return "none"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, Mapping | list | tuple):
        plain = list(value) if isinstance(value, tuple) else value
        return f"`{yaml.safe_dump(plain, default_flow_style=True, sort_keys=False, width=1000).strip()}`"
    return f"`{value}`"


def _table(heads: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    heads = tuple(heads)
    lines = [heads, tuple("---" for _ in heads), *rows]
    return "\n".join(
        "| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in line) + " |"
        for line in lines
    )


def commands() -> str:
    """Usage and options of all commands."""
    parts: list[str] = []
    for name in COMMANDS:
        parser = make_parser([name])
        parts += _command(f"orchestrator {name}", _subcommands(parser)[name], COMMANDS[name][0])
    return "\n\n".join(parts)


def _subcommands(parser: argparse.ArgumentParser) -> Mapping[str, argparse.ArgumentParser]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return action.choices
    return {}


def _command(name: str, parser: argparse.ArgumentParser, purpose: str, level: int = 3) -> Iterator[str]:
    yield f"{'#' * level} {name}"
    text = " ".join((parser.description or purpose).split())
    yield text[:1].upper() + text[1:] + ("" if text.endswith(".") else ".")
    rows = []
    for action in parser._actions:
        if isinstance(action, argparse._HelpAction | argparse._SubParsersAction):
            continue
        known = action.default in (None, False, "", [], argparse.SUPPRESS) or "default" in (action.help or "")
        default = "" if known else f" (default: {action.default})"
        rows.append((f"`{_invocation(action)}`", _help(action, parser) + default))
    if rows:
        yield _table(("argument", "meaning"), rows)
    helps = {
        one.dest: one.help or ""
        for action in parser._actions
        if isinstance(action, argparse._SubParsersAction)
        for one in action._choices_actions
    }
    for key, inner in _subcommands(parser).items():
        yield from _command(f"{name} {key}", inner, helps.get(key, ""), level + 1)


def _invocation(action: argparse.Action) -> str:
    """An argument as it is written."""
    metavar = action.metavar or (None if action.choices else action.dest.upper())
    names = "|".join(map(str, action.choices)) if metavar is None and action.choices else str(metavar)
    if action.nargs == "+":
        names += " ..."
    elif action.nargs in ("*", "?"):
        names = f"[{names}{' ...' if action.nargs == '*' else ''}]"
    elif isinstance(action.nargs, int) and action.nargs > 1:
        names = " ".join([names] * action.nargs)
    if not action.option_strings:
        return names
    flags = ", ".join(action.option_strings)
    return flags if action.nargs == 0 else f"{flags} {names}"


def _help(action: argparse.Action, parser: argparse.ArgumentParser) -> str:
    text = (action.help or "") % {**vars(action), "prog": parser.prog}
    return " ".join(text.replace("*", "\\*").split())


def python_api() -> str:
    """The public names, and the types that they return."""
    public = {name: getattr(orchestrator, name) for name in orchestrator.__all__ if name != "__version__"}
    functions = [(name, one) for name, one in public.items() if not inspect.isclass(one)]
    errors = [
        (name, one) for name, one in public.items() if inspect.isclass(one) and issubclass(one, Exception)
    ]
    classes = [one for one in public.items() if one not in functions and one not in errors]
    returned = [(place.partition(":")[2], _loaded(place)) for place in _RETURNED]
    parts = ["## Functions"]
    for name, one in functions:
        parts += [f"### orc.{name}", _signature(f"orc.{name}", one), _docstring(one)]
    for title, group in (("Classes", classes), ("Returned types", returned), ("Errors", errors)):
        parts.append(f"## {title}")
        for name, one in group:
            parts += _class_parts(name, one)
    return "\n\n".join(parts)


def _loaded(place: str) -> Any:
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)


def _class_parts(name: str, one: type) -> Iterator[str]:
    yield f"### {name}"
    yield _docstring(one)
    if "__init__" in vars(one) and not hasattr(one, "__dataclass_fields__"):
        yield _signature(name, one.__init__)
        yield _docstring(one.__init__) if vars(one)["__init__"].__doc__ else ""
    for key, member in vars(one).items():
        if key.startswith("_") and key != "__getitem__":
            continue
        plain = member.__func__ if isinstance(member, classmethod | staticmethod) else member
        if isinstance(member, property) and inspect.getdoc(member):
            yield f"**`{key}`** — {_docstring(member)}"
        elif inspect.isfunction(plain) and inspect.getdoc(plain):
            yield f"#### `{name}.{key}`"
            yield _signature(key, plain)
            yield _docstring(plain)


def _signature(name: str, function: Callable[..., Any]) -> str:
    """The signature as a block of code; annotations as they are written."""
    signature = inspect.signature(function)
    shown: list[str] = []
    keyword_only = False
    for one in signature.parameters.values():
        if one.name in ("self", "cls"):
            continue
        if one.kind is one.KEYWORD_ONLY and not keyword_only:
            keyword_only = True
            if not any(other.kind is other.VAR_POSITIONAL for other in signature.parameters.values()):
                shown.append("*")
        stars = {one.VAR_POSITIONAL: "*", one.VAR_KEYWORD: "**"}.get(one.kind, "")
        text = stars + one.name
        if one.annotation is not one.empty:
            text += f": {one.annotation}"
        if one.default is not one.empty:
            text += f" = {one.default!r}" if ":" in text else f"={one.default!r}"
        shown.append(text)
    result = (
        ""
        if signature.return_annotation in (signature.empty, "None")
        else f" -> {signature.return_annotation}"
    )
    line = f"{name}({', '.join(shown)}){result}"
    if len(line) > 90:
        line = f"{name}(\n" + "".join(f"    {one},\n" for one in shown) + f"){result}"
    return f"```python\n{line}\n```"


def _docstring(one: Any) -> str:
    """A docstring in Google's style -> Markdown."""
    parts: list[str] = []
    for block in re.split(r"\n(?=(?:Args|Attributes|Returns|Raises):)|\n\n", inspect.getdoc(one) or ""):
        section = re.match(r"(Args|Attributes|Returns|Raises):\s*", block)
        if section is None:
            code = all(line.startswith("    ") for line in block.splitlines())
            parts.append(f"```python\n{inspect.cleandoc(block)}\n```" if code and block else _plain(block))
        elif section[1] in ("Returns", "Raises"):
            parts.append(f"*{section[1]}:* {_plain(' '.join(block[section.end() :].split()))}")
        else:
            title = "Arguments" if section[1] == "Args" else section[1]
            parts.append(f"*{title}:*\n\n" + "\n".join(_items(block[section.end() :])))
    return "\n\n".join(parts)


def _items(body: str) -> Iterator[str]:
    """The entries of a section `Args` or `Attributes`."""
    entries = re.findall(r"^ *([*\w]+(?:, [*\w]+)*): (.*(?:\n {8,}.*)*)", f"    {body.lstrip()}", re.M)
    for names, text in entries:
        yield f"- {', '.join(f'`{name}`' for name in names.split(', '))}: {_plain(' '.join(text.split()))}"


def _plain(text: str) -> str:
    """Text without emphasis: asterisks outside of code are escaped."""
    return "`".join(
        part if place % 2 else part.replace("*", "\\*") for place, part in enumerate(text.split("`"))
    )


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Put generated parts into a page. Raises: KeyError if there is none of a name."""
    return re.sub(r"<!-- reference: (\S+) -->", lambda found: PAGES[found[1]](), markdown)


def laws() -> str:
    """The laws of the search by unknown inputs: a table and a picture of each domain."""
    parts: list[str] = []
    for title, members in domains().items():
        rows = [
            "| law | family | equations | acts at | reads | where it occurs |",
            "|---|---|---|---|---|---|",
        ]
        for law in members:
            read = _READS.get(law.reads, law.reads) + (f", {law.second}" if law.second else "")
            places = _AT[law.at] if law.at else _places(law)
            rows.append(
                f"| {law.name} | {law.family} | `{law.modelica}` | {places} | {read} | {law.sentence} |"
            )
        parts += [f"## {title}", "\n".join(rows), _drawn(members)]
    return "\n\n".join(parts)


_READS = {
    "own": "signal at the place",
    "other": "another signal of the component",
    "any": "any signal of the component",
    "rate": "speed",
}
_AT = {
    "force": "forces, torques, derivatives of speeds",
    "flow": "flows, levels, temperatures, pressures",
    "electric": "voltages, currents",
}
_KINDS = {1: "inputs", 2: "derivatives of states", 3: "outputs", 4: "between two states of a component"}


def _places(law: Law) -> str:
    return ", ".join(_KINDS[one] for one in law.kinds or (1, 2, 3))


def _drawn(members: list[Law]) -> str:
    """w of each law against its signal, a wave that grows; an image in the page itself.

    A law with states that reads a speed is drawn over the travel.
    """
    count, interval = 200, 0.05
    time = interval * np.arange(count)
    signal = time / time[-1] * np.sin(1.5 * time)
    sizes = {"spread": 0.4, "interval": interval, "rate": 1.0 / interval, "one": 1.0, "run": time[-1],
             "slope": 0.8, "step": 0.4 * interval, "second": 0.9, "product": 0.2, "range": 2.0,
             "second range": 2.0, "second step": 0.36 * interval, "tone": 6.0,
             "most": float(np.abs(signal).max())}  # fmt: skip
    columns = 6
    lines = -(-len(members) // columns)
    figure = Figure(figsize=(10.0, 1.5 * lines), layout="constrained")
    axes = figure.subplots(lines, columns, squeeze=False).flat
    for law, one in zip(members, axes, strict=False):
        numbers = law.starts(sizes, {"range": -1.0, "second range": -1.0})[0]
        read = np.gradient(signal, interval) if law.reads == "rate" and law.states else signal
        read = np.column_stack([read, np.cos(0.4 * time)]) if law.second else read
        one.plot(signal, law.values(time, read, numbers, interval), linewidth=0.8, color="#0072B2")
        one.set_title(law.name, fontsize=7)
    for one in axes:
        one.set_axis_off()
    for one in figure.axes[: len(members)]:
        one.set_axis_on()
        one.set(xticks=[], yticks=[])
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=80)
    image = base64.b64encode(file.getvalue()).decode()
    return f'<img alt="w against the signal, of each law" src="data:image/png;base64,{image}">'


PAGES: dict[str, Callable[[], str]] = {
    "config-keys": config_keys,
    "study-keys": study_keys,
    "commands": commands,
    "python-api": python_api,
    "laws": laws,
}
