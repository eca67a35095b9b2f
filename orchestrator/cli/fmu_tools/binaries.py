"""Shared libraries of any platform, read as object files: nothing of them is run."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

# Folder under binaries/ -> kind and architectures at least one of them must be there.
_PLATFORMS = {
    "win32": ("PE", ("x86",)),
    "win64": ("PE", ("x86_64",)),
    "linux32": ("ELF", ("x86",)),
    "linux64": ("ELF", ("x86_64", "aarch64")),
    "darwin64": ("Mach-O", ("x86_64", "aarch64")),
}
_KINDS = {"windows": "PE", "linux": "ELF", "darwin": "Mach-O"}

_SYSTEMS = {"win": "windows", "linux": "linux", "darwin": "darwin"}

# What every installation of the platform has: the C library, the loader, and Windows' own interfaces.
_SYSTEM_STEMS = {
    "ELF": ("libc", "libm", "libdl", "libpthread", "librt", "ld-linux", "libgcc_s", "libstdc++"),
    "PE": ("kernel32", "user32", "advapi32", "ws2_32", "ole32", "shell32", "ntdll", "msvcrt", "ucrtbase",
           "api-ms-win-"),
    "Mach-O": ("/usr/lib/", "/System/Library/"),
}  # fmt: skip


@dataclass(frozen=True)
class Image:
    """One library for one architecture; a universal file of macOS holds several.

    Attributes:
        kind: "ELF", "PE" or "Mach-O".
        architecture: "x86_64", "aarch64", "x86", or the reader's name of another one.
        shared: whether it is a library that can be loaded, as against a program or an object file.
        exports: names of the functions that others can call, without the underscore of macOS.
        needs: libraries that the loader will look for, as the file names them.
    """

    kind: str
    architecture: str
    shared: bool
    exports: frozenset[str]
    needs: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """The image without its exports, for JSON."""
        return {key: value for key, value in asdict(self).items() if key != "exports"}


# Of one architecture and of several, in either order of bytes (mach-o/loader.h, mach-o/fat.h).
_MACHO = (b"\xcf\xfa\xed\xfe", b"\xce\xfa\xed\xfe", b"\xfe\xed\xfa\xcf", b"\xfe\xed\xfa\xce",
          b"\xca\xfe\xba\xbe")  # fmt: skip
_ARCHITECTURES = {
    "X86_64": "x86_64", "AMD64": "x86_64", "ARM64": "aarch64", "AARCH64": "aarch64",
    "I386": "x86", "X86": "x86",
}  # fmt: skip


def read_images(data: bytes) -> tuple[Image, ...]:
    """The images in a file's content. Raises: ValueError if it is no object file that is known."""
    import lief

    lief.logging.disable()  # it would write to standard output
    if data[:4] in _MACHO:
        fat = lief.MachO.parse(data)
        found = tuple(_macho(one) for one in fat) if fat is not None else ()
    else:
        parsed = lief.parse(data)
        if isinstance(parsed, lief.ELF.Binary):
            found = (_elf(parsed),)
        elif isinstance(parsed, lief.PE.Binary):
            found = (_pe(parsed),)
        else:
            found = ()
    if not found:
        raise ValueError(f"neither ELF nor PE nor Mach-O; it begins with {data[:8]!r}")
    return found


def _architecture(value: Any) -> str:
    return _ARCHITECTURES.get(value.name.upper(), value.name.lower())


def _elf(image: Any) -> Image:
    import lief

    return Image(
        kind="ELF",
        architecture=_architecture(image.header.machine_type),
        shared=image.header.file_type == lief.ELF.Header.FILE_TYPE.DYN,
        exports=frozenset(str(one.name) for one in image.exported_symbols),
        needs=tuple(str(one) for one in image.libraries),
    )


def _pe(image: Any) -> Image:
    import lief

    export = image.get_export() if image.has_exports else None
    delayed = image.delay_imports if image.has_delay_imports else ()
    return Image(
        kind="PE",
        architecture=_architecture(image.header.machine),
        shared=image.header.has_characteristic(lief.PE.Header.CHARACTERISTICS.DLL),
        exports=frozenset(str(one.name) for one in export.entries) if export is not None else frozenset(),
        needs=tuple(str(one.name) for one in (*image.imports, *delayed)),
    )


def _macho(image: Any) -> Image:
    import lief

    own = lief.MachO.LoadCommand.TYPE.ID_DYLIB
    return Image(
        kind="Mach-O",
        architecture=_architecture(image.header.cpu_type),
        shared=image.header.file_type == lief.MachO.Header.FILE_TYPE.DYLIB,
        exports=frozenset(str(one.name).removeprefix("_") for one in image.exported_symbols),
        needs=tuple(str(one.name) for one in image.libraries if one.command != own),
    )


def wanted_images(folder: str) -> tuple[str, tuple[str, ...]] | None:
    """Kind and possible architectures of libraries in binaries/<folder>; None for a folder of another name.

    FMI 2.0.4, 2.3 names "win64" and the like; FMI 3.0, 2.5.1.4 "x86_64-windows".
    """
    if folder in _PLATFORMS:
        return _PLATFORMS[folder]
    architecture, _, system = folder.partition("-")
    kind = _KINDS.get(system.partition("-")[0])
    return None if kind is None else (kind, (architecture,))


def platform_names(folder: str, architectures: Iterable[str] = ()) -> tuple[str, tuple[str, ...]]:
    """What binaries/<folder> is called in FMI 2.0 and, by architecture, in FMI 3.0; empty without a name.

    Args:
        architectures: of the libraries in it; FMI 2.0 has one folder for several of them.
    """
    if folder in _PLATFORMS:
        system = _SYSTEMS[folder.rstrip("0123456789")]
        known = [one for one in _PLATFORMS[folder][1] if one in set(architectures)] or _PLATFORMS[folder][1][
            :1
        ]
        return folder, tuple(f"{one}-{system}" for one in known)
    if wanted_images(folder) is None:
        return "", ()
    architecture, _, system = folder.partition("-")
    kind = _KINDS[system.partition("-")[0]]
    older = (name for name, (own, able) in _PLATFORMS.items() if own == kind and architecture in able)
    return next(older, ""), (folder,)


def is_system_library(kind: str, name: str) -> bool:
    """Whether every installation of the image's platform has a library."""
    return name.lower().startswith(_SYSTEM_STEMS[kind]) or name.startswith(_SYSTEM_STEMS[kind])
