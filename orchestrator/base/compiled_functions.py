"""Functions that numba compiles, kept on disk until any source changes that they may be made of.

numba keeps machine code until the file of the function itself changes, while what it calls and the constants
that it reads are compiled into it: where those stand in another file, code of before an upgrade would go on
serving. Here a digest of all sources stands in the names of the files that are kept. In the names and not in
the index alone: numba writes the index before the code, so that a process that is killed in between would
leave new marks upon old code.
"""

from __future__ import annotations

import os
import re
import sys
import time
from collections.abc import Callable, Iterator
from enum import Enum
from functools import cache
from hashlib import sha256
from pathlib import Path
from threading import RLock
from types import CodeType, FunctionType, ModuleType
from typing import TYPE_CHECKING, Any, TypeVar

from . import LOADED
from .provenance import versions

if TYPE_CHECKING:
    from numba.core.caching import _CacheLocator

_Made = TypeVar("_Made")

_PACKAGE = Path(__file__).parents[1]
# What machine code is made with; Python's version stands in the names of files as numba gives them.
_TOOLS = ("numba", "llvmlite", "numpy")
_LETTERS = 16
# Of each function the code of so many other states of the sources stays: who goes to and fro between two
# versions does not compile each time.
_OTHERS = 2
# Kept files of a function: its line (or, of a notebook, its text), the digest, Python's version.
_KEPT_FILE = r"[0-9a-f]+(?:-([0-9a-f]{%d}))?\.%s\.(?:nbi|\d+\.nbc)"
_PYTHON = f"py{sys.version_info[0]}{sys.version_info[1]}{getattr(sys, 'abiflags', '')}"
_CONSTANTS = (bool, int, float, complex, str, bytes, Enum)


def njit(*, allocates: bool = True, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`numba.njit`, and what it compiles is kept on disk where there is a place for it.

    Args:
        allocates: whether the function makes arrays. If it does not, numba counts no references to the arrays
            that it slices. In short functions these counts take half of the time.
    """
    from numba import njit

    options["_nrt"] = allocates
    return lambda function: _made(lambda keep: njit(cache=keep, **options)(function))


def cfunc(signature: Any) -> Callable[[Callable[..., Any]], Any]:
    """`numba.cfunc`, and what it compiles is kept on disk where there is a place for it."""
    from numba import cfunc

    return lambda function: _made(lambda keep: cfunc(signature, cache=keep)(function))


@cache
def digest() -> str:
    """Digest of the package's sources and of the tools that compile them; empty where nothing may be kept.

    Any file counts: which ones reach a function is unknown, since constants are compiled into it. Nothing
    is kept where a file has changed since the package was loaded: what runs may be of before the change.
    """
    found = sorted(_sources(str(_PACKAGE)))
    if not found or any(_changed(state) for _, state in found):
        return ""
    counted = sha256(repr(versions(_TOOLS)).encode())
    try:
        for path, _ in found:
            with open(path, "rb") as file:
                content = file.read()
            counted.update(f"{os.path.relpath(path, _PACKAGE)} {len(content)}\n".encode())
            counted.update(content)
    except OSError:
        return ""
    return counted.hexdigest()[:_LETTERS]


def is_kept(source: Path, function: str) -> bool:
    """Whether machine code of a function of the package is kept beside its source, made of what is there now.

    Where numba keeps it elsewhere, since that folder cannot be written, it counts as not kept.
    """
    if not (now := digest()):
        return False
    return any(source.parent.glob(f"__pycache__/{source.stem}.{function}-*-{now}.{_PYTHON}.*.nbc"))


def _sources(folder: str) -> Iterator[tuple[str, os.stat_result]]:
    """Python files of a folder and those within, and their states."""
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                if entry.is_dir():
                    if entry.name != "__pycache__":
                        yield from _sources(entry.path)
                elif entry.name.endswith(".py"):
                    yield entry.path, entry.stat()
    except OSError:  # in an archive, say
        return


def _changed(state: os.stat_result) -> bool:
    """Whether a file has changed since the package was loaded.

    Copies may keep the time of their content: that of the file itself counts as well. What is to come is the
    time of another clock, and says nothing.
    """
    return any(LOADED < at <= time.time_ns() for at in (state.st_mtime_ns, state.st_ctime_ns))


def _made(make: Callable[[bool], _Made]) -> _Made:
    """What numba makes with our locators, or without keeping it where that cannot be.

    Args:
        make: is reported whether to keep it.
    """
    from numba.core import config

    # The environment's choice of locators, which numba reads for each function that is to be kept; where a
    # numba has none, nothing is kept, rather than by its own.
    if digest() and hasattr(config, "CACHE_LOCATOR_CLASSES"):
        with _CHOOSING:
            before = config.CACHE_LOCATOR_CLASSES
            config.CACHE_LOCATOR_CLASSES = ",".join(f"{__name__}.{name}" for name in _LOCATORS)
            try:
                return make(True)
            except RuntimeError:  # no place for it, neither beside its file nor in the user's folder
                pass
            finally:
                config.CACHE_LOCATOR_CLASSES = before
    return make(False)


_CHOOSING = RLock()
# In the order in which numba tries its own, which are their bases; one for archives is not among them.
_LOCATORS = ("UserProvidedCacheLocator", "InTreeCacheLocator", "UserWideCacheLocator", "IPythonCacheLocator")


class _BySources:
    """A locator of numba, with the digest of all sources in the names of files."""

    _digest = ""

    @classmethod
    def from_function(cls, py_func: FunctionType, py_file: str) -> Any:
        found = super().from_function(py_func, py_file)  # type: ignore[misc]
        if found is None:
            return None
        own, files = digest(), {py_file}
        if not Path(py_file).is_relative_to(_PACKAGE):
            reached, constants = _reached(py_func)
            files |= reached
            counted = sha256(f"{own} {found.get_source_stamp()}".encode())
            for content in [*map(_content, sorted(files)), *constants]:
                counted.update(b"%d " % len(content) + content)
            own = counted.hexdigest()[:_LETTERS]
        if any(os.path.exists(file) and _changed(os.stat(file)) for file in files):
            return None
        name = f"{Path(py_file).stem}.{py_func.__qualname__}-".replace("<", "").replace(">", "")
        found._files = re.compile(re.escape(name) + _KEPT_FILE % (_LETTERS, re.escape(_PYTHON)))
        found._digest = own
        return found

    def get_disambiguator(self) -> str:
        return f"{super().get_disambiguator()}-{self._digest}"  # type: ignore[misc]

    def ensure_cache_path(self) -> None:
        super().ensure_cache_path()  # type: ignore[misc]
        if self._digest:  # before something is kept, not when the place is looked for
            self._make_room()

    def _make_room(self) -> None:
        """Remove this function's code of older states of the sources; whoever runs them compiles it again."""
        last: dict[str, float] = {}
        others: list[tuple[str, str]] = []
        try:
            with os.scandir(self.get_cache_path()) as entries:  # type: ignore[attr-defined]
                for entry in entries:
                    match = self._files.fullmatch(entry.name)  # type: ignore[attr-defined]
                    if match and match[1] != self._digest:
                        state = match[1] or ""
                        others.append((state, entry.path))
                        # Without a digest: kept before files were named by it, and never to be used again.
                        if state:
                            last[state] = max(last.get(state, 0.0), entry.stat().st_mtime)
        except OSError:  # another process makes room as well
            return
        stay = sorted(last, key=last.__getitem__)[-_OTHERS:]
        for state, path in others:
            if state not in stay:
                try:
                    os.unlink(path)
                except OSError:  # gone, or in use
                    pass


def __getattr__(name: str) -> type[_CacheLocator]:
    """Locators, by which numba finds them here; made when numba is there."""
    if name not in _LOCATORS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from numba.core import caching

    made = globals()[name] = type(name, (_BySources, getattr(caching, name)), {})
    return made


def _reached(function: Any) -> tuple[set[str], list[bytes]]:
    """What a function outside the package is made of: the files of all that it names, and the constants.

    Left out are the standard library, this package and the libraries below it: `digest` says about them.
    """

    def left_out(module: str) -> bool:
        return module.partition(".")[0] in {*sys.stdlib_module_names, *_TOOLS, __package__.partition(".")[0]}

    files: set[str] = set()
    constants: list[bytes] = []
    done: dict[int, Any] = {}
    ahead: list[tuple[str, Any]] = [("", function)]
    while ahead:
        name, one = ahead.pop()
        if _is_constant(one):
            content = one.tobytes() if hasattr(one, "tobytes") else b""
            constants.append(f"{name} = {one!r}\n".encode() + content)
            continue
        home = one.__name__ if isinstance(one, ModuleType) else getattr(one, "__module__", None)
        if not isinstance(home, str) or (left_out(home) and done) or id(one) in done:
            continue
        done[id(one)] = one
        ahead += [("", getattr(one, name)) for name in ("py_func", "__wrapped__") if hasattr(one, name)]
        if file := getattr(sys.modules.get(home), "__file__", None):
            files.add(file)
        if isinstance(one, FunctionType):
            names = sorted(_names(one.__code__))
            named = [(name, one.__globals__[name]) for name in names if name in one.__globals__]
            modules = [each for _, each in named if isinstance(each, ModuleType)]
            for module in (each for each in modules if not left_out(each.__name__)):
                named += [(name, getattr(module, name)) for name in names if hasattr(module, name)]
            # Constants among what it closes over stand in numba's own index.
            ahead += named + [("", each) for each in _cells(one) if not _is_constant(each)]
    return files, sorted(constants)


def _cells(function: FunctionType) -> Iterator[Any]:
    """What a function closes over."""
    for cell in function.__closure__ or ():
        try:
            yield cell.cell_contents
        except ValueError:  # not yet there
            pass


def _content(file: str) -> bytes:
    """Content of a file; empty for a notebook's cell, which numba's stamp identifies."""
    return Path(file).read_bytes() if os.path.exists(file) else b""


def _is_constant(value: Any) -> bool:
    """Whether numba compiles a value into the code that reads it."""
    if isinstance(value, tuple):
        return all(map(_is_constant, value))
    if isinstance(value, type):
        return False
    return isinstance(value, _CONSTANTS) or (hasattr(value, "tobytes") and hasattr(value, "dtype"))


def _names(code: CodeType) -> set[str]:
    """Names that code reads from its module or from others, those within it included."""
    inner = (one for one in code.co_consts if isinstance(one, CodeType))
    return set(code.co_names).union(*map(_names, inner))
