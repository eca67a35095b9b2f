"""A copy of a component's module in which its functions take traced numbers."""

from __future__ import annotations

import builtins
import inspect
import math
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

from orchestrator.base.errors import BuildError

from .explore import Explorer
from .shared_source import pieces
from .traced_library import SHADOWS, TracedMath


def source_line(error: BaseException, script: Path) -> str:
    """The line that an error comes from: ":12" of the script, ", shared/x.py:12" of a module; "" if none."""
    labels = {str(piece.path): piece.label for piece in pieces(script)}
    frames = traceback.extract_tb(error.__traceback__)
    places = [(frame.filename, frame.lineno) for frame in frames if frame.filename in labels]
    if not places:
        return ""
    file, line = places[-1]
    return f":{line}" if file == str(script) else f", {labels[file]}:{line}"


@contextmanager
def loaded_copy(script: Path) -> Iterator[ModuleType]:
    """A copy of the model, with what it shares, in which `math` and some builtins take traced numbers."""
    name = f"traced_{script.stem}"
    module = ModuleType(name)
    before, sys.modules[name] = sys.modules.get(name), module
    try:
        try:
            for piece in pieces(script):
                exec(compile(piece.text, str(piece.path), "exec", dont_inherit=True), vars(module))
        except Exception as error:
            raise BuildError(f"{script.name}: cannot be loaded: {type(error).__name__}: {error}") from error
        yield module
    finally:
        if before is None:
            del sys.modules[name]
        else:
            sys.modules[name] = before


def instrument(module: ModuleType, explorer: Explorer) -> None:
    """Let the module's functions take traced numbers, and join the paths of each call."""
    traced_math = TracedMath()
    for name, value in list(vars(module).items()):
        if value is math:
            setattr(module, name, traced_math)
        elif getattr(math, name, None) is value and callable(value):
            setattr(module, name, getattr(traced_math, name))
        elif isinstance(value, FunctionType) and value.__module__ == module.__name__:
            setattr(module, name, _joined(explorer, value))
        elif inspect.isclass(value) and value.__module__ == module.__name__:
            for key, member in list(vars(value).items()):
                own = isinstance(member, FunctionType) and member.__module__ == module.__name__
                if own and not key.startswith("__"):
                    setattr(value, key, _joined(explorer, member))
    for name, function in SHADOWS.items():
        if getattr(module, name, getattr(builtins, name)) is getattr(builtins, name):
            setattr(module, name, function)


def _joined(explorer: Explorer, function: FunctionType) -> Callable[..., Any]:
    return function if inspect.isgeneratorfunction(function) else explorer.joined(function)
