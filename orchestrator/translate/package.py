"""Compile the C sources of an FMU for every platform and write the FMU archive, reproducibly."""

from __future__ import annotations

import atexit
import hashlib
import os
import platform as host
import re
import shutil
import struct
import subprocess
import sys
import threading
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import resources
from importlib.util import find_spec
from pathlib import Path
from typing import Literal
from xml.sax.saxutils import quoteattr

from orchestrator.base.atomic_files import whole_file
from orchestrator.base.errors import BuildError
from orchestrator.base.temporary_folders import scratch_folder

FmiVersion = Literal["2.0", "3.0"]

TOKEN_MARK = "@TOKEN@"
"""Stands for the token in the generated text until the token, which depends on the text, is known."""

# Of the runtime, in every model description.
LOG_CATEGORIES = {
    "logStatusWarning": "Warnings, such as a failed assertion of level warning",
    "logStatusDiscard": "Steps that could not be completed",
    "logStatusError": "Errors",
    "logEvents": "Times of events and the relations that caused them",
}


@dataclass(frozen=True)
class Platform:
    """How one platform is compiled for and where FMI keeps its binary."""

    target: str  # triple of `zig cc`
    folder_fmi2: str
    folder_fmi3: str
    suffix: str
    flags: tuple[str, ...]


_ELF_FLAGS = ("-fPIC", "-Wl,--build-id=none", "-Wl,-z,defs", "-lm")
# Apple silicon refuses to load unsigned code: the linker's ad-hoc signature stays. It is made of page
# hashes and the library's name alone, so it is the same in every build.
_MAC_FLAGS = ("-fPIC", "-Wl,-install_name,@rpath/{name}.dylib")

PLATFORMS: Mapping[str, Platform] = {
    # 2.17 is the oldest glibc of the manylinux2014 generation.
    "x86_64-linux": Platform("x86_64-linux-gnu.2.17", "linux64", "x86_64-linux", ".so", _ELF_FLAGS),
    "x86_64-windows": Platform("x86_64-windows-gnu", "win64", "x86_64-windows", ".dll", ()),
    "x86_64-darwin": Platform("x86_64-macos", "darwin64", "x86_64-darwin", ".dylib", _MAC_FLAGS),
    # FMI 2.0 knows one folder for both kinds of Mac; a universal binary serves them.
    "aarch64-darwin": Platform("aarch64-macos", "darwin64", "aarch64-darwin", ".dylib", _MAC_FLAGS),
}


def c_string(text: str) -> str:
    """A text as a literal of C."""
    escaped = "".join(_escape(byte) for byte in text.encode())
    return f'"{escaped}"'


def _escape(byte: int) -> str:
    character = chr(byte)
    if character in '"\\?':
        return "\\" + character
    # Octal, three digits: a hexadecimal escape would swallow the characters behind it.
    return character if 32 <= byte < 127 else f"\\{byte:03o}"


def named_platforms(names: Sequence[str]) -> tuple[str, ...]:
    """Keys of `PLATFORMS` for names of platforms.

    Args:
        names: keys, or names of FMI 2.0's folders: linux64, win64, darwin64 (both kinds of Mac).
    Raises: BuildError with all names that are unknown.
    """
    found: dict[str, None] = {}
    unknown = []
    for name in names:
        keys = [key for key, one in PLATFORMS.items() if name in (key, one.folder_fmi2)]
        found.update(dict.fromkeys(keys))
        unknown += [] if keys else [name]
    if unknown:
        folders = dict.fromkeys(one.folder_fmi2 for one in PLATFORMS.values())
        raise BuildError(
            f"unknown platform {', '.join(unknown)}; known: {', '.join(PLATFORMS)}, or by the folders of "
            f"FMI 2.0 {', '.join(folders)}"
        )
    return tuple(found)


def this_platform() -> str:
    """The key of `PLATFORMS` that stands for this machine.

    Raises: BuildError if binaries cannot be made for it.
    """
    machine = host.machine().lower()
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(machine, machine)
    name = f"{machine}-{host.system().lower()}"
    if name not in PLATFORMS:
        raise BuildError(
            f"--platforms: binaries cannot be made for this machine, {name}; "
            f"name some of {', '.join(PLATFORMS)}, or give all, or none for C sources only"
        )
    return name


_FLAGS = (
    "-std=c99",
    "-O2",
    "-g0",
    "-s",
    "-shared",
    "-fvisibility=hidden",
    # Strict floating point, and no fused multiply-add where the source has none: with it the two kinds
    # of Mac would differ in the last bits.
    "-ffp-contract=off",
    "-fno-fast-math",
    # `zig cc` instruments C with traps for undefined behaviour unless it is asked not to.
    "-fno-sanitize=all",
    # Without the C library's assert: it would embed file names.
    "-DNDEBUG",
    "-Wall",
    "-Wextra",
)

# The earliest date a zip archive can hold.
_ZIP_DATE = (1980, 1, 1, 0, 0, 0)
_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\Z")
_HEADERS = {
    "2.0": ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    "3.0": ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
}
_INTERFACE = {"2.0": ("fmi2.c", "fmi2_absent.c"), "3.0": ("fmi3.c", "fmi3_absent.c")}
# What a component that advances in steps has no use for; runtime/stepped/ stands in for it.
_ONE_AT_A_TIME = threading.Lock()
_CONTINUOUS = ("delay.c", "evaluate.c", "integrate.c", "integrate.h", "step.c")


def runtime_sources(fmi_version: FmiVersion, stepped: bool = False) -> dict[str, bytes]:
    """Return the C files of the runtime and the FMI headers, by file name.

    Args:
        fmi_version: "2.0" or "3.0"; decides which interface files are part of it.
        stepped: for a model.c written for runtime/stepped/stepmodel.h instead of runtime/model.h alone.
    Returns: file name -> content; together with a `model.c` they compile without anything else.
    Raises: BuildError if fmpy, which carries the headers of the FMI standard, is not installed.
    """
    _check_version(fmi_version)
    other = _INTERFACE["3.0" if fmi_version == "2.0" else "2.0"]
    runtime = resources.files("orchestrator.translate") / "runtime"
    items = list(runtime.iterdir())
    if stepped:
        other += _CONTINUOUS
        items += (runtime / "stepped").iterdir()
    sources = {
        item.name: item.read_bytes()
        for item in items
        if item.name.endswith((".c", ".h")) and item.name not in other
    }
    sources |= interface_headers(fmi_version)
    # A checkout with CRLF line ends must give the same FMU.
    return {name: sources[name].replace(b"\r\n", b"\n") for name in sorted(sources)}


def content_token(parts: Sequence[bytes]) -> str:
    """A GUID made of the contents: unlike sources get unlike tokens, like sources the same."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(len(part).to_bytes(8, "little"))
        digest.update(part)
    text = digest.hexdigest()
    return f"{{{text[:8]}-{text[8:12]}-{text[12:16]}-{text[16:20]}-{text[20:32]}}}"


def source_members(
    code: str,
    sources: Mapping[str, bytes],
    identifier: str,
    fmi_version: FmiVersion,
    describe: Callable[[str], bytes],
) -> dict[str, bytes]:
    """The description and the C sources of an FMU, with a token made of both.

    Args:
        code: of model.c, with `TOKEN_MARK` where the token goes.
        sources: the other files, by name.
        identifier: the model identifier.
        describe: writes the model description with a token.
    Returns: path within the FMU -> content.
    """
    token = content_token([code.encode(), describe(TOKEN_MARK), *(sources[key] for key in sorted(sources))])
    files = {**sources, "model.c": code.replace(TOKEN_MARK, token).encode()}
    if fmi_version == "3.0":
        files["buildDescription.xml"] = build_description(identifier, list(files))
    members = {f"sources/{file}": content for file, content in files.items()}
    members["modelDescription.xml"] = describe(token)
    return members


def hybrid_sources(fmi_version: FmiVersion) -> dict[str, bytes]:
    """As `runtime_sources`, for a model.c written for runtime/hybrid/hybrid.h."""
    sources = runtime_sources(fmi_version, stepped=True)
    major, other = ("2", "3") if fmi_version == "2.0" else ("3", "2")
    # They are parts of the file that adds model exchange to them.
    sources[f"fmi{major}_steps.h"] = sources.pop(f"fmi{major}.c")
    refusals = sources.pop(f"fmi{major}_absent.c")
    if fmi_version == "3.0":
        sources["fmi3_refusals.h"] = refusals
    for item in (resources.files("orchestrator.translate") / "runtime" / "hybrid").iterdir():
        if item.name.endswith((".c", ".h")) and not item.name.startswith(f"fmi{other}_"):
            sources[item.name] = item.read_bytes().replace(b"\r\n", b"\n")
    return {name: sources[name] for name in sorted(sources)}


def interface_headers(fmi_version: FmiVersion) -> dict[str, bytes]:
    """The C headers of the FMI standard, by file name.

    Raises: BuildError if fmpy, which carries them, is not installed.
    """
    spec = find_spec("fmpy")
    if spec is None or spec.origin is None:
        raise BuildError(
            "FMI headers: the package fmpy, which carries them, is not installed; run `pip install fmpy`"
        )
    folder = Path(spec.origin).parent / "c-code"
    try:
        return {name: (folder / name).read_bytes() for name in _HEADERS[fmi_version]}
    except OSError as error:
        raise BuildError(
            f"FMI headers: cannot read {error.filename} of the installed fmpy: {error.strerror}"
        ) from error


def build_description(model_identifier: str, sources: Sequence[str]) -> bytes:
    """Return `sources/buildDescription.xml`, which FMI 3.0 asks for beside C sources.

    Args:
        model_identifier: name of the binary without its ending.
        sources: file names in `sources/`; only the C files among them are listed.
    """
    _check_identifier(model_identifier)
    files = "".join(
        f"      <SourceFile name={quoteattr(name)}/>\n" for name in sorted(sources) if name.endswith(".c")
    )
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        '<fmiBuildDescription fmiVersion="3.0">\n'
        f"  <BuildConfiguration modelIdentifier={quoteattr(model_identifier)}>\n"
        '    <SourceFileSet language="C99">\n'
        f"{files}"
        "    </SourceFileSet>\n"
        "  </BuildConfiguration>\n"
        "</fmiBuildDescription>\n"
    ).encode()


def binary_member(platform: str, model_identifier: str, fmi_version: FmiVersion) -> str:
    """Return the path of a platform's binary within the FMU.

    Args:
        platform: a key of `PLATFORMS`.
        model_identifier: name of the binary without its ending.
        fmi_version: "2.0" or "3.0".
    Raises: BuildError for an unknown platform or version.
    """
    _check_version(fmi_version)
    _check_identifier(model_identifier)
    known = _platform(platform)
    folder = known.folder_fmi2 if fmi_version == "2.0" else known.folder_fmi3
    return f"binaries/{folder}/{model_identifier}{known.suffix}"


def compile_library(
    sources_dir: Path,
    model_identifier: str,
    fmi_version: FmiVersion,
    platforms: Sequence[str],
    libraries: Sequence[str] = (),
) -> dict[str, bytes]:
    """Compile the C files of a folder to one shared library per platform.

    The result depends on the sources and the compiler's version alone: no path, date or build id gets
    in, and only FMI functions are exported.

    Args:
        sources_dir: folder with the runtime, the FMI headers and `model.c`.
        model_identifier: name of the library without its ending; Mac and Windows libraries hold it.
        fmi_version: "2.0" or "3.0"; interface files of the other version are left out.
        platforms: keys of `PLATFORMS`.
        libraries: of the system, needed on Linux besides the C library.
    Returns: platform -> content of the library. FMI 2.0 has one place for both kinds of Mac: where both
        are asked for, both get the same universal library.
    Raises: BuildError if the compiler is missing or refuses a file; the message quotes the compiler.
    """
    _check_version(fmi_version)
    _check_identifier(model_identifier)
    other = _INTERFACE["3.0" if fmi_version == "2.0" else "2.0"]
    names = sorted(path.name for path in Path(sources_dir).glob("*.c") if path.name not in other)
    if not names:
        raise BuildError(f"{sources_dir}: no C files to compile")
    if find_spec("ziglang") is None:
        raise BuildError(
            "C compiler: the package ziglang is not installed; run `pip install 'ziglang>=0.17,<0.18'`"
        )
    built = {}
    linked = [f"-l{name}" for name in libraries]
    for platform in platforms:
        known = _platform(platform)
        # Compiled from a copy under relative names, so that no path can reach the library.
        with _workshop(Path(sources_dir)) as scratch:
            library = scratch / f"{model_identifier}{known.suffix}"
            flags = [*_FLAGS, *(flag.format(name=model_identifier) for flag in known.flags)]
            flags += linked if known.suffix == ".so" else []
            _run_compiler(
                ["-target", known.target, "-I.", "-o", library.name, *names, *flags], scratch, platform
            )
            content = library.read_bytes()
        built[platform] = content
    return join_macs(built) if fmi_version == "2.0" else built


def join_macs(libraries: Mapping[str, bytes]) -> dict[str, bytes]:
    """Libraries by platform, those of both kinds of Mac replaced by a universal one that serves both."""
    joined = dict(libraries)
    if {"x86_64-darwin", "aarch64-darwin"} <= joined.keys():
        both = _universal({name: joined[name] for name in ("x86_64-darwin", "aarch64-darwin")})
        joined["x86_64-darwin"] = joined["aarch64-darwin"] = both
    return joined


def write_fmu(path: Path, members: Mapping[str, bytes]) -> None:
    """Write an FMU whose bytes depend on its members alone; a failed write leaves no file behind.

    Members are stored, not deflated: builds of zlib differ in what they make of the same bytes, and a
    version control system packs stored archives better than deflated ones.

    Args:
        path: the file to write; replaced at once when complete.
        members: path within the archive (with "/") -> content.
    Raises: BuildError if a member's path is absolute or leaves the archive; OSError if writing fails.
    """
    path = Path(path)
    for name in members:
        if (
            not name
            or name.startswith("/")
            or "\\" in name
            or any(part in ("", ".", "..") for part in name.split("/"))
        ):
            raise BuildError(f"{path.name}: {name!r} is no path within an FMU; give a relative path with '/'")
    with whole_file(path) as stream, zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        for name in sorted(members):
            info = zipfile.ZipInfo(name, _ZIP_DATE)
            info.create_system = 3  # Unix, wherever this runs
            info.external_attr = 0o100644 << 16
            info.compress_type = zipfile.ZIP_STORED
            archive.writestr(info, members[name])


def _universal(libraries: Mapping[str, bytes]) -> bytes:
    """Join Mach-O libraries of different processors to one file (layout: Apple's mach-o/fat.h)."""
    processors = {"x86_64-darwin": (0x01000007, 3), "aarch64-darwin": (0x0100000C, 0)}
    alignment = 14  # 2**14 bytes: the larger page size of the two
    header = struct.pack(">II", 0xCAFEBABE, len(libraries))
    content = b""
    offset = 1 << alignment
    for platform, library in libraries.items():
        content += b"\0" * (offset - (1 << alignment) - len(content)) + library
        header += struct.pack(">5I", *processors[platform], offset, len(library), alignment)
        offset += -(-len(library) >> alignment) << alignment
    return header.ljust(1 << alignment, b"\0") + content


@contextmanager
def _workshop(sources: Path) -> Iterator[Path]:
    """A folder with a copy of the sources and nothing else, the same one for all builds of this process.

    The compiler keeps the object of a file that stands where it stood and was not written again: the C
    runtime is compiled once per platform and process, not once per FMU.
    """
    with _ONE_AT_A_TIME:
        folder = _folder_of(os.getpid())
        wanted = {path.name: path.read_bytes() for path in sources.iterdir() if path.suffix in (".c", ".h")}
        for path in folder.iterdir():
            if path.name not in wanted or path.read_bytes() != wanted[path.name]:
                path.unlink()
        for name in wanted.keys() - {path.name for path in folder.iterdir()}:
            (folder / name).write_bytes(wanted[name])
        yield folder


@cache
def _folder_of(process: int) -> Path:
    folder = scratch_folder("fmu-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def _run_compiler(arguments: Sequence[str], folder: Path, platform: str) -> None:
    environment = {key: value for key, value in os.environ.items() if key != "SOURCE_DATE_EPOCH"}
    result = subprocess.run(
        [sys.executable, "-m", "ziglang", "cc", *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        errors="replace",
    )
    if result.returncode != 0:
        message = (result.stderr or result.stdout).strip()
        raise BuildError(f"C compiler, {platform}: exit status {result.returncode}\n{message}")


def _platform(name: str) -> Platform:
    if name not in PLATFORMS:
        raise BuildError(f"unknown platform {name!r}; known: {', '.join(PLATFORMS)}")
    return PLATFORMS[name]


def _check_version(fmi_version: str) -> None:
    if fmi_version not in _INTERFACE:
        raise BuildError(f"unknown FMI version {fmi_version!r}; known: {', '.join(_INTERFACE)}")


def _check_identifier(name: str) -> None:
    if not _IDENTIFIER.match(name):
        raise BuildError(
            f"model identifier {name!r} is no C identifier; "
            "use letters, digits and underscores, no digit first"
        )
