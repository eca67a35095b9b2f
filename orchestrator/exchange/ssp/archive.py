"""The files of a system structure package, read without trusting it: a zip archive, or the folder of a .ssd.

References lead to files of the same package only. Nothing is unpacked but what is asked for as a file, and
only into the folder that the caller gives.
"""

from __future__ import annotations

import io
import posixpath
import shutil
import zipfile
import zlib
from pathlib import Path, PurePosixPath
from urllib.parse import unquote, urlsplit

from ...base.errors import ConfigError, FmuError, Problem, listed, nearest
from ...fmi.archive import check_document, check_members

# Read into memory: descriptions, parameters, and packages within packages.
LARGEST_READ = 512 * 2**20
# Of all that is read, each use of a file counted: references to one file may make much of little.
MOST_TIMES_READ, SMALLEST_READ = 20, 8 * 2**20


class TooMuch(ConfigError):
    """A package that expands too far: nothing more of it is read."""


class _Reading:
    """What is read of a package and of those within it: each use of a file is one.

    Args:
        packed: size of the package [B]; of a folder, that of the files that were read.
    """

    def __init__(self, packed: int) -> None:
        self._packed, self._read = packed, 0
        self._files: set[Path] = set()

    def found(self, file: Path, size: int) -> None:
        """A file of a folder, of so many bytes."""
        if file not in self._files:
            self._files.add(file)
            self._packed += size

    def begins(self, size: int, place: str) -> None:
        """So many bytes are about to be read. Raises: TooMuch."""
        self._read += size
        if self._read > max(SMALLEST_READ, MOST_TIMES_READ * self._packed):
            allowed = f"at most {MOST_TIMES_READ} times its size, or {SMALLEST_READ} bytes, are read"
            what = f"what the package refers to comes to more than {self._read - size} bytes; its size is "
            raise TooMuch([Problem(place, f"{what}{self._packed} bytes", allowed)])


class Package:
    """Files by their paths within a package, with "/" between folders.

    Attributes:
        label: for messages, "X.ssp" or "X.ssp: resources/Y.ssp".
    """

    def __init__(self, label: str, archive: zipfile.ZipFile | None, root: Path, reading: _Reading) -> None:
        """Use `open_package`. `root`: of an archive, where files go; otherwise the folder itself."""
        self.label, self._archive, self._root, self._reading = label, archive, root, reading

    def names(self) -> list[str]:
        """Paths of the files; of a folder only those at its top."""
        if self._archive is not None:
            return [one.filename for one in self._archive.infolist() if not one.is_dir()]
        return sorted(path.name for path in self._root.iterdir() if path.is_file())

    def has(self, path: str) -> bool:
        """Whether there is such a file."""
        if self._archive is not None:
            return path in self._archive.NameToInfo
        return self._within(path).is_file()

    def read(self, path: str, place: str) -> bytes:
        """Content of a file. Raises: ConfigError if it is missing, too large or broken; TooMuch."""
        self._needed(path, place)
        try:
            if self._archive is None:
                size, content = self._within(path).stat().st_size, None
                self._reading.found(self._within(path), size)
            else:
                size, content = self._archive.getinfo(path).file_size, self._archive
                if not path.lower().endswith(".ssp"):
                    check_document(self.label, self._archive.getinfo(path))
            if size > LARGEST_READ:
                allowed = f"at most {LARGEST_READ} are accepted"
                raise ConfigError([Problem(place, f"{path} has {size} bytes", allowed)])
            self._reading.begins(size, place)
            return content.read(path) if content is not None else self._within(path).read_bytes()
        except FmuError as error:
            raise TooMuch([Problem("", str(error))]) from None
        except _UNREADABLE as error:
            raise ConfigError([Problem(place, f"{path} cannot be read ({error})", "", _AGAIN)]) from error

    def file(self, path: str, place: str) -> Path:
        """A file on disk, unpacked at the first call. Raises: ConfigError as `read`."""
        self._needed(path, place)
        if self._archive is None:
            return self._within(path)
        target = self._root.joinpath(*PurePosixPath(path).parts)
        if target.is_file():
            return target
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            with self._archive.open(path) as source, open(target, "xb") as copy:
                shutil.copyfileobj(source, copy)
        except _UNREADABLE as error:
            raise ConfigError([Problem(place, f"{path} cannot be unpacked ({error})", "", _AGAIN)]) from error
        return target

    def inner(self, path: str, place: str) -> Package:
        """A package within this one. Raises: ConfigError as `open_package`."""
        content = io.BytesIO(self.read(path, place))
        root = self._root.joinpath(*PurePosixPath(f"{path}.d").parts)
        return _of_zip(content, len(content.getbuffer()), f"{self.label}: {path}", root, self._reading)

    def _within(self, path: str) -> Path:
        """A path in the folder; leads nowhere if it is a link to the outside."""
        found = self._root.joinpath(*PurePosixPath(path).parts)
        inside = found.resolve().is_relative_to(self._root.resolve())
        return found if inside else self._root / "outside of the folder"

    def _needed(self, path: str, place: str) -> None:
        if not self.has(path):
            names = self.names()
            allowed = f"{self.label} holds {listed(names)}"
            raise ConfigError([Problem(place, f"no file {path!r}", allowed, nearest(path, names))])


# What reading a damaged archive raises.
_UNREADABLE = (OSError, EOFError, RuntimeError, NotImplementedError, zipfile.BadZipFile, zlib.error)
_AGAIN = "Export or download it again."


def open_package(path: Path, root: Path) -> Package:
    """A package: a zip archive (.ssp), or the folder that a .ssd stands in.

    Args:
        path: of the .ssp or .ssd file.
        root: folder for files that have to be unpacked; made when the first is.
    Raises: ConfigError if it is no zip archive, or has entries that would harm.
    """
    if path.suffix.lower() == ".ssd":
        # Whoever reads the config takes relative paths in it from the folder of the file.
        return Package(path.name, None, path.parent.absolute(), _Reading(0))
    try:
        size = path.stat().st_size
    except OSError as error:
        raise ConfigError([Problem(path.name, f"cannot be read ({error})")]) from error
    return _of_zip(path, size, path.name, root)


def _of_zip(
    content: io.BytesIO | Path, size: int, label: str, root: Path, reading: _Reading | None = None
) -> Package:
    try:
        archive = zipfile.ZipFile(content)
    except (zipfile.BadZipFile, OSError, ValueError) as error:
        what = f"no system structure package, since it is no whole zip archive ({error})"
        raise ConfigError([Problem(label, what, "", _AGAIN)]) from error
    members = archive.infolist()
    try:
        check_members(label, size, members)
    except FmuError as error:
        raise ConfigError([Problem("", str(error))]) from None
    names: set[str] = set()
    for member in members:
        if member.filename in names:
            what = f"refused, two of its entries are called {member.filename!r}"
            raise ConfigError([Problem(label, what, "each name may stand once", _AGAIN)])
        names.add(member.filename)
    return Package(label, archive, root, reading or _Reading(size))


def referenced(source: str, base: str, place: str) -> tuple[str, str]:
    """Path within the package, and fragment, of a reference.

    Args:
        source: the URI as written.
        base: path of the file that it stands in.
    Raises: ConfigError if it leads out of the package.
    """
    try:
        parts = urlsplit(source)
    except ValueError as error:
        raise ConfigError([Problem(place, f"{source!r} is no reference ({error})")]) from None
    if parts.scheme or parts.netloc or source.startswith("/") or "\\" in source:
        allowed = "references lead to files of the same package, such as resources/Model.fmu"
        what = f"{source!r} refers to something outside of the package"
        raise ConfigError(
            [Problem(place, what, allowed, "Put the file into the package, and refer to it there.")]
        )
    path = posixpath.normpath(posixpath.join(posixpath.dirname(base), unquote(parts.path)))
    if path.startswith("..") or path.startswith("/"):
        allowed = "references lead to files of the same package"
        raise ConfigError([Problem(place, f"{source!r} leads out of the package", allowed)])
    return (path if parts.path else base), unquote(parts.fragment)
