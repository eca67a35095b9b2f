"""A config that is not right everywhere: what of it can be read, and where it has gaps."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import NoneType
from typing import Any, get_args, get_origin

from pydantic import BaseModel, TypeAdapter, ValidationError

from ..base.errors import Problem, close
from .external import ExternalModel
from .models import (
    Arrow,
    BondModel,
    ConnectionModel,
    InstanceModel,
    RunModel,
    SourceModel,
    SystemModel,
    named_twice,
)
from .problems import is_of_another_form, names_of, path_within, unknown_key, validation_problems
from .text import Path, Places
from .unresolved import Gaps

_ARROW = TypeAdapter(Arrow)
_NAMED = ("instances", "external")
# For the keys of an external one that its ports do not depend on.
_ANY_PEER = {"listen": "127.0.0.1:1", "peer": "127.0.0.1:2", "exchange": "latest"}


def correct_spelling(
    data: dict[str, Any], places: Places, model: type[BaseModel]
) -> tuple[list[Problem], dict[str, str]]:
    """Give misspelt sections the one name that they can be meant for, so that what is in them is read, too.

    Args:
        data: plain values of a whole file; it and `places` are changed.
        model: what its sections are known by.
    Returns: a problem of each, and the name that each has now.
    """
    names, problems, meant = names_of(model), list[Problem](), dict[str, str]()
    kinds = dict(zip(names, (one.annotation for one in model.model_fields.values()), strict=True))
    for key, value in data.items():
        near = close(str(key), names)
        if key in names or len(near) != 1 or near[0] in (*data, *meant.values()):
            continue
        if _takes(kinds[near[0]], value):
            problems.append(unknown_key(places, (key,), names))
            meant[key] = near[0]
    if meant:
        renamed = {meant.get(key, key): value for key, value in data.items()}
        data.clear()
        data.update(renamed)
        inner = [(path, place) for path, place in places.known.items() if path and path[0] in meant]
        places.known.update(((meant[str(path[0])], *path[1:]), place) for path, place in inner)
    return problems, meant


def read_model(
    data: Mapping[str, Any], places: Places, gaps: Gaps
) -> tuple[SystemModel, list[Problem], Gaps]:
    """The model of a config's plain values, as far as they can be read.

    Where there are gaps, the model was not validated as a whole: of `run`, keys that are not known are
    missing; instances, external ones and measures that are not known are left out; connections and bonds that
    are not are None, and of connections that are known in part the rest is empty.

    Args:
        gaps: known before.
    Returns: the model, what is wrong, and all gaps.
    """
    try:
        return SystemModel.model_validate(data), [], gaps
    except ValidationError as error:
        reader = _Reader(data, places, error, gaps)
        model = reader.model()
        problems = validation_problems(error, places, (), SystemModel, gaps)
        return model, problems + reader.problems, reader.gaps()


class _Reader:
    """Reads what is right of a config.

    Attributes:
        problems: that the error does not list: pydantic checks the keys of a part together only if each is
            right.
    """

    def __init__(self, data: Mapping[str, Any], places: Places, error: ValidationError, gaps: Gaps) -> None:
        self._data, self._places = data, places
        self.problems: list[Problem] = []
        self._gaps, self._wholes = set(gaps.paths), set[Path]()
        for item in error.errors(include_url=False):
            path, kind = path_within(data, item["loc"]), item["type"]
            if kind == "extra_forbidden":
                self._gaps.update(_likely_keys(self._at(path[:-1]), path, self._at(path)))
            elif kind == "value_error" and (not path or (len(path) == 2 and path[0] in _NAMED)):
                self._wholes.add(path)  # its keys do not go together
            elif path[:1] == ("connections",) and len(path) > 1:
                continue  # see `_connection`
            elif item["loc"][-1:] == ("[key]",) and "." not in str(path[-1]):
                continue  # a name that is refused is a name all the same
            elif is_of_another_form(item):
                continue
            else:
                self._gaps.add((*path, item["loc"][-1]) if kind == "missing" else path)

    def gaps(self) -> Gaps:
        """All that are known."""
        return Gaps(frozenset(self._gaps))

    def _at(self, path: Path) -> Any:
        found: Any = self._data
        for part in path:
            found = found[part]
        return found

    def _section(self, key: str, kind: type) -> Any:
        found = self._data.get(key)
        return found if isinstance(found, kind) and (key,) not in self._gaps else kind()

    def model(self) -> SystemModel:
        """What is right."""
        model = SystemModel.model_construct(
            title=self._data.get("title", ""),
            run=RunModel.model_construct(**self._sound(RunModel, ("run",))),
            instances=self._each("instances", self._instance),
            external=self._each("external", self._external),
            connections=[
                self._connection(n, one) for n, one in enumerate(self._section("connections", list))
            ],
            bonds=[self._bond(n, one) for n, one in enumerate(self._section("bonds", list))]
            if self._data.get("bonds", "auto") != "auto"
            else "auto",
            measures={
                name: one
                for name, one in self._section("measures", dict).items()
                if ("measures", name) not in self._gaps
            },
        )
        try:
            named_twice(model.instances, model.external)
        except ValueError as error:
            if () not in self._wholes:
                self.problems.append(Problem(self._places.text(()), str(error)))
        return model

    def _each(self, section: str, read: Any) -> dict[str, Any]:
        made = {name: read((section, name)) for name in self._section(section, dict)}
        self._gaps.update((section, name) for name, one in made.items() if one is None)
        return {name: one for name, one in made.items() if one is not None}

    def _sound(self, kind: type[BaseModel], path: Path) -> dict[str, Any]:
        """The keys of a part that are right; of `start` and the like, the entries that are."""
        found: Any = self._data
        for part in path:
            found = found.get(part) if isinstance(found, Mapping) else None
        if path in self._gaps or not isinstance(found, Mapping):
            return {}
        sound = {}
        for key, value in found.items():
            if key not in kind.model_fields or (*path, key) in self._gaps:
                continue
            wrong = {one[len(path) + 1] for one in self._gaps if one[: len(path) + 1] == (*path, key)}
            if isinstance(value, Mapping):
                value = {name: one for name, one in value.items() if name not in wrong}
            sound[key] = value
        return sound

    def _instance(self, path: Path) -> InstanceModel | None:
        sound = self._sound(InstanceModel, path)
        if "fmu" not in sound:
            return None
        return self._validated(InstanceModel, sound, path) or InstanceModel.model_construct(**sound)

    def _external(self, path: Path) -> ExternalModel | None:
        if not all(self.gaps().whole(*path, key) for key in ("send", "receive")):
            return None
        return self._validated(ExternalModel, _ANY_PEER | self._sound(ExternalModel, path), path)

    def _validated(self, kind: Any, sound: dict[str, Any], path: Path) -> Any:
        """A part without what is wrong in it; None if its keys do not go together."""
        try:
            return kind.model_validate(sound)
        except ValidationError as error:
            known, as_whole = self.gaps(), all(not one["loc"] for one in error.errors())
            # With another value of a key that is not known they may.
            sure = as_whole and all(known.knows(*path, key) for key in kind.model_fields)
            if sure and path not in self._wholes:
                self.problems += validation_problems(error, self._places, path, kind)
            return None

    def _bond(self, number: int, data: Any) -> BondModel | None:
        if self.gaps().whole("bonds", number):
            try:
                return BondModel.model_validate(data)
            except ValidationError:
                pass  # an unknown key
        self._gaps.add(("bonds", number))
        return None

    def _connection(self, number: int, data: Any) -> str | ConnectionModel | None:
        path = ("connections", number)
        if not isinstance(data, Mapping):
            if _fits(_ARROW, data):
                return data
            self._gaps.add(path)
            return None
        given = data.get("from", data.get("source"))
        sources = [
            self._source((*path, "from", n), one)
            for n, one in enumerate(given if isinstance(given, list) else [given])
        ]
        if not any(sources):
            self._gaps.add((*path, "from"))
        target, through = data.get("to", data.get("target")), data.get("through", [])
        if not isinstance(target, str):
            self._gaps.add((*path, "to"))
        if not isinstance(through, list):
            self._gaps.add((*path, "through"))
        return ConnectionModel.model_construct(
            source=[one for one in sources if one is not None],
            target=target if isinstance(target, str) else "",
            through=through if isinstance(through, list) else [],
        )

    def _source(self, path: Path, data: Any) -> str | SourceModel | None:
        if isinstance(data, str):
            return data
        try:
            return SourceModel.model_validate(data)
        except ValidationError:
            self._gaps.add(path)
        port = data.get("port") if isinstance(data, Mapping) else None
        return port if isinstance(port, str) else None


def _fits(adapter: TypeAdapter[Any], data: Any) -> bool:
    try:
        adapter.validate_python(data)
    except ValidationError:
        return False
    return True


def _likely_keys(data: Mapping[str, Any], path: Path, value: Any) -> Iterable[Path]:
    """What an unknown key may be meant for: keys not given of a like name or, without any, of such values."""
    above = path[:-1]
    kinds: dict[str | int, type[BaseModel]] = {
        "run": RunModel,
        "instances": InstanceModel,
        "external": ExternalModel,
        "connections": ConnectionModel,
    }
    sections = (("run",), 1), (("instances", "external", "connections"), 2)
    kind = SystemModel if not above else None
    for names, length in sections:
        if len(above) == length and above[0] in names:
            kind = kinds[above[0]]
    if kind is None:
        return []
    absent = {
        one.alias or name: one.annotation
        for name, one in kind.model_fields.items()
        if (one.alias or name) not in data
    }
    like = close(str(path[-1]), absent)
    return [
        (*above, key)
        for key, annotation in absent.items()
        if key in like or (not like and _takes(annotation, value))
    ]


def _takes(annotation: Any, value: Any) -> bool:
    """Whether a mapping, or a list, may stand where an annotation asks for it; of other values never."""
    if annotation is Any:
        return isinstance(value, Mapping | list)
    wanted = get_origin(annotation) or annotation
    if isinstance(wanted, type) and wanted is not NoneType:
        if isinstance(value, Mapping):
            return issubclass(wanted, Mapping | dict | BaseModel)
        return isinstance(value, list) and issubclass(wanted, list)
    return any(_takes(one, value) for one in get_args(annotation))
