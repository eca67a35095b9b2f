"""Unpacking an FMU without trusting it."""

from __future__ import annotations

import shutil
import stat
import threading
import zipfile
import zlib
from pathlib import Path, PurePosixPath

from ..base.errors import FmuError, listed
from ..base.temporary_folders import scratch_folder

# Far above any FMU met in practice, and below what fills a disk unnoticed. The sizes that an archive declares
# bind: zipfile reads no entry beyond its own.
LARGEST_UNPACKED = 8 * 2**30
MOST_ENTRIES = 100_000
# Tables of numbers shrink to a tenth, seldom to a hundredth; a bomb's zeros to a thousandth.
LARGEST_EXPANSION = 200
SMALLEST_BOMB = 256 * 2**20
# Of an XML file, which costs far more to read than to unpack: descriptions shrink to a tenth.
LARGEST_DOCUMENT = 512 * 2**20
DOCUMENT_EXPANSION, SMALLEST_DOCUMENT = 100, 4 * 2**20
# Other methods unpack without bounds: zipfile limits what it reads at once for this one only.
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


def binary_folder(fmi_version: str) -> str:
    """Name of this platform's folder under binaries/, for example "linux64" or "x86_64-linux"."""
    import fmpy

    return fmpy.platform_tuple if fmi_version.startswith("3") else fmpy.platform


def checked_members(path: Path) -> list[zipfile.ZipInfo]:
    """The entries of an archive that would harm nothing if it were unpacked.

    Raises: FmuError if it cannot be read, or as `check_members`.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as error:
        raise FmuError(f"{path}: cannot be read ({error})") from error
    check_members(path, path.stat().st_size, members)
    return members


def check_members(label: Path | str, packed: int, members: list[zipfile.ZipInfo]) -> None:
    """Check an archive by its table of contents.

    Args:
        label: of the archive, for messages.
        packed: its size [B].
    Raises: FmuError if it has entries that would be written elsewhere, over each other or as links, that are
        encrypted or packed otherwise than the standards say, or more of them than a disk should take.
    """
    taken: dict[str, zipfile.ZipInfo] = {}
    for member in members:
        name = PurePosixPath(member.filename.replace("\\", "/"))
        if not name.parts or name.is_absolute() or ".." in name.parts or ":" in name.parts[0]:
            raise FmuError(f"{label}: refused, its entry {member.filename!r} would be written elsewhere")
        if stat.S_ISLNK(member.external_attr >> 16):
            raise FmuError(f"{label}: refused, its entry {member.filename!r} is a symbolic link")
        if member.flag_bits & 1:
            raise FmuError(f"{label}: refused, its entry {member.filename!r} is encrypted")
        if member.compress_type not in _METHODS:
            raise FmuError(
                f"{label}: refused, its entry {member.filename!r} is packed by method "
                f"{member.compress_type}\n  allowed: stored (0) and deflated (8)"
            )
        if member.is_dir():
            continue
        # Readers differ in which of two they take, so that one could be checked and the other be run; where
        # letters' case does not count, names that differ in it are one.
        other = taken.setdefault(str(name).casefold(), member)
        # The same file twice, which exporters write by mistake, does no harm.
        if (other.filename, other.CRC, other.file_size) != (member.filename, member.CRC, member.file_size):
            raise FmuError(
                f"{label}: refused, its entries {other.filename!r} and {member.filename!r} would be written "
                f"to one file, and differ"
            )
    for member in members:
        parts = PurePosixPath(member.filename.replace("\\", "/").casefold()).parts
        for end in range(1, len(parts)):
            folder = "/".join(parts[:end])
            if folder in taken:
                raise FmuError(
                    f"{label}: refused, its entry {taken[folder].filename!r} is a file, and a folder of "
                    f"{member.filename!r}"
                )
    if len(members) > MOST_ENTRIES:
        raise FmuError(
            f"{label}: refused, it has {len(members)} entries; at most {MOST_ENTRIES} are accepted"
        )
    size = sum(member.file_size for member in members)
    if size > max(SMALLEST_BOMB, LARGEST_EXPANSION * packed):
        raise FmuError(
            f"{label}: refused, its {packed} bytes unpack to {size}; at most {LARGEST_EXPANSION} "
            f"times the archive, or {SMALLEST_BOMB} bytes, are accepted"
        )
    if size > LARGEST_UNPACKED:
        raise FmuError(
            f"{label}: refused, unpacked it is {size} bytes; at most {LARGEST_UNPACKED} are accepted"
        )


def check_document(label: Path | str, member: zipfile.ZipInfo) -> None:
    """Check an XML file in an archive before it is read. Raises: FmuError if it expands too far."""
    most = max(SMALLEST_DOCUMENT, DOCUMENT_EXPANSION * member.compress_size)
    if member.file_size > min(most, LARGEST_DOCUMENT):
        raise FmuError(
            f"{label}: refused, the {member.compress_size} bytes of {member.filename} unpack to "
            f"{member.file_size}; at most {DOCUMENT_EXPANSION} times as many, or {SMALLEST_DOCUMENT} bytes, "
            f"and {LARGEST_DOCUMENT} bytes, are accepted"
        )


class Unpacked:
    """An FMU in a temporary folder, which is removed with the last user.

    Instances of one FMU share the folder and the library in it, those of several threads, too.

    Attributes:
        corrupt: whether an instance has returned "fatal": then none of this FMU may be called any more, not
            even to be freed (FMI 2.0.4, 2.1.3).
    """

    corrupt = False

    def __init__(self, path: Path, fmi_version: str, model_identifier: str) -> None:
        self._path = path
        self._platform = binary_folder(fmi_version)
        self._identifier = model_identifier
        self._users = 0
        # Reentrant: what is collected as garbage meanwhile may give the folder up.
        self._lock = threading.RLock()
        self._folder: Path | None = None

    def check(self) -> None:
        """Check the archive without unpacking it.

        Raises: FmuError if it has no library for this platform, or entries that would harm.
        """
        self._check_platform([member.filename for member in checked_members(self._path)])

    def acquire(self) -> Path:
        """The folder, unpacked at the first call. Raises: FmuError."""
        with self._lock:
            if self._folder is None:
                folder = scratch_folder("fmu-")
                try:
                    self._unpack(folder)
                except BaseException:
                    shutil.rmtree(folder, ignore_errors=True)
                    raise
                self._folder = folder
            self._users += 1
            return self._folder

    def release(self) -> None:
        """Give the folder up; the last one removes it."""
        with self._lock:
            self._users -= 1
            if self._users == 0 and self._folder is not None:
                # On Windows a library that is still loaded cannot be deleted: the system's clean-up gets it.
                shutil.rmtree(self._folder, ignore_errors=True)
                self._folder = None
                # What is loaded next comes from another folder, hence is another library.
                self.corrupt = False

    def _unpack(self, folder: Path) -> None:
        self.check()
        try:
            with zipfile.ZipFile(self._path) as archive:
                needed = [member for member in archive.infolist() if self._needed(member.filename)]
                size, free = sum(member.file_size for member in needed), shutil.disk_usage(folder).free
                if size > free:
                    raise FmuError(
                        f"{self._path}: cannot be unpacked, it needs {size} bytes and "
                        f"{folder.parent} has {free}"
                    )
                for member in needed:
                    archive.extract(member, folder)
                # Its place is asked to the FMU, and some look there without need.
                (folder / "resources").mkdir(exist_ok=True)
        except (zipfile.BadZipFile, zlib.error, OSError, EOFError, RuntimeError) as error:
            raise FmuError(f"{self._path}: cannot be unpacked ({error})") from error

    def _check_platform(self, names: list[str]) -> None:
        platforms: dict[str, list[str]] = {}
        for name in names:
            parts = PurePosixPath(name).parts
            if len(parts) == 3 and parts[0] == "binaries":
                platforms.setdefault(parts[1], []).append(parts[2])
        stems = {PurePosixPath(file).stem for file in platforms.get(self._platform, ())}
        if self._identifier in stems:
            return
        if self._platform in platforms:
            raise FmuError(
                f"{self._path}: binaries/{self._platform} holds no library {self._identifier}; "
                f"it holds {listed(sorted(platforms[self._platform]))}"
            )
        raise FmuError(
            f"{self._path}: no binary for this platform, {self._platform}; "
            f"it has binaries for: {listed(sorted(platforms))}\n"
            f"  Export it for {self._platform}, or run it on a platform that it has."
        )

    def _needed(self, name: str) -> bool:
        parts = PurePosixPath(name).parts
        if parts[0] in ("sources", "documentation"):
            return False
        return parts[0] != "binaries" or (len(parts) > 1 and parts[1] == self._platform)
