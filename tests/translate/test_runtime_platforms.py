"""Compiled libraries of all platforms, read as what they are, and the archive they go into."""

from __future__ import annotations

import os
import re
import struct
import subprocess
import zipfile
from pathlib import Path
from sys import executable

import fmpy
import pytest
from runtime_bench import needs_compiler, unpacked, write_sources

from orchestrator.base.errors import BuildError
from orchestrator.translate.coupled import binary
from orchestrator.translate.package import (
    PLATFORMS,
    binary_member,
    build_description,
    compile_library,
    runtime_sources,
    write_fmu,
)


def cstring(data: bytes, at: int) -> str:
    return data[at : data.index(b"\0", at)].decode()


def elf_exports(data: bytes) -> tuple[int, set[str]]:
    """Machine and defined dynamic symbols (System V ABI, ELF-64)."""
    assert data[:6] == b"\x7fELF\x02\x01"
    machine = struct.unpack_from("<H", data, 18)[0]
    sections_at = struct.unpack_from("<Q", data, 40)[0]
    size, count = struct.unpack_from("<2H", data, 58)
    sections = [struct.unpack_from("<IIQQQQIIQQ", data, sections_at + i * size) for i in range(count)]
    names = set()
    for kind, offset, length, link in ((s[1], s[4], s[5], s[6]) for s in sections):
        if kind != 11:  # SHT_DYNSYM
            continue
        for at in range(offset, offset + length, 24):
            name, _, _, section = struct.unpack_from("<IBBH", data, at)
            if section:
                names.add(cstring(data, sections[link][4] + name))
    return machine, names


def pe_exports(data: bytes) -> tuple[int, set[str], int]:
    """Machine, exported names and date field (Microsoft PE format)."""
    header = struct.unpack_from("<I", data, 60)[0]
    assert data[:2] == b"MZ" and data[header : header + 4] == b"PE\0\0"
    machine, n_sections, date = struct.unpack_from("<HHI", data, header + 4)
    optional_size = struct.unpack_from("<H", data, header + 20)[0]
    optional = header + 24
    export_address = struct.unpack_from("<I", data, optional + 112)[0]
    sections = [
        struct.unpack_from("<8sIIII", data, optional + optional_size + 40 * i)[1:] for i in range(n_sections)
    ]

    def place(address: int) -> int:
        for size, start, _, raw in sections:
            if start <= address < start + size:
                return address - start + raw
        raise AssertionError(address)

    count = struct.unpack_from("<I", data, place(export_address) + 24)[0]
    table = place(struct.unpack_from("<I", data, place(export_address) + 32)[0])
    names = {cstring(data, place(struct.unpack_from("<I", data, table + 4 * i)[0])) for i in range(count)}
    return machine, names, date


def macho_exports(data: bytes) -> tuple[int, set[str]]:
    """Processor and external defined symbols (Apple mach-o/loader.h, mach-o/nlist.h)."""
    magic, processor, _, kind, n_commands = struct.unpack_from("<5I", data)
    assert (magic, kind) == (0xFEEDFACF, 6)
    at, names = 32, set()
    for _ in range(n_commands):
        command, size = struct.unpack_from("<2I", data, at)
        if command == 2:  # LC_SYMTAB
            symbols, count, strings, _ = struct.unpack_from("<4I", data, at + 8)
            for i in range(count):
                name, flags = struct.unpack_from("<IB", data, symbols + 16 * i)
                if flags & 1 and flags & 0x0E:  # N_EXT, and defined
                    names.add(cstring(data, strings + name))
        at += size
    # Labels that the linker puts at the beginning of every library.
    return processor, {name.removeprefix("_") for name in names} - {"_mh_dylib_header", "__dso_handle"}


def declared(version: str) -> set[str]:
    """Every function of the standard's header."""
    headers = Path(fmpy.__file__).parent / "c-code"
    text = (headers / f"fmi{version[0]}Functions.h").read_text()
    return set(re.findall(rf"^\s*FMI{version[0]}_Export\s+\w+\s+(\w+);", text, re.MULTILINE))


@pytest.fixture(scope="module")
def libraries(tmp_path_factory):
    folder = tmp_path_factory.mktemp("platforms")
    return {
        version: compile_library(
            write_sources(folder / version, "contact", version), "contact", version, list(PLATFORMS)
        )
        for version in ("2.0", "3.0")
    }


@needs_compiler
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_each_platform_exports_the_whole_interface_and_nothing_else(libraries, version):
    expected = declared(version)
    assert len(expected) == {"2.0": 44, "3.0": 75}[version]
    built = libraries[version]
    assert elf_exports(built["x86_64-linux"]) == (62, expected)
    assert pe_exports(built["x86_64-windows"])[:2] == (0x8664, expected)
    intel, apple = built["x86_64-darwin"], built["aarch64-darwin"]
    if version == "2.0":
        # One folder for both: a universal library with both inside.
        assert intel == apple
        magic, count, *entries = struct.unpack_from(">12I", intel)
        assert (magic, count) == (0xCAFEBABE, 2)
        assert all(entry % (1 << 14) == 0 for entry in (entries[2], entries[7]))
        apple = intel[entries[7] : entries[7] + entries[8]]
        intel = intel[entries[2] : entries[2] + entries[3]]
    assert macho_exports(intel) == (0x01000007, expected)
    assert macho_exports(apple) == (0x0100000C, expected)


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_the_binaries_of_systems_export_the_whole_interface_and_nothing_else(version):
    expected = declared(version)
    assert elf_exports(binary("x86_64-linux", version)) == (62, expected)
    assert pe_exports(binary("x86_64-windows", version))[:2] == (0x8664, expected)
    assert macho_exports(binary("x86_64-darwin", version)) == (0x01000007, expected)
    assert macho_exports(binary("aarch64-darwin", version)) == (0x0100000C, expected)
    for platform in PLATFORMS:
        for trace in (b"/tmp", os.fsencode(Path.home()), os.fsencode(os.getcwd()), b"coupling.c", b".pdb"):
            assert trace not in binary(platform, version), (platform, trace)


@needs_compiler
def test_no_path_gets_into_a_library(libraries):
    for version, built in libraries.items():
        for platform, data in built.items():
            for trace in (b"/tmp", os.fsencode(Path.home()), os.fsencode(os.getcwd()), b"step.c", b".pdb"):
                assert trace not in data, (version, platform, trace)


@needs_compiler
def test_another_folder_gives_the_same_bytes(tmp_path, libraries):
    # Another length of path and other sources beside it: a header of the other FMI version.
    folder = write_sources(tmp_path / "a folder of another name" / "deeper", "contact", "2.0")
    (folder / "fmi3.c").write_text("#error the other version is left out\n")
    for platform in ("x86_64-linux", "x86_64-windows"):
        again = compile_library(folder, "contact", "2.0", [platform])
        assert again[platform] == libraries["2.0"][platform]


@needs_compiler
def test_the_compiler_finds_nothing_to_warn_about(tmp_path):
    for version in ("2.0", "3.0"):
        folder = write_sources(tmp_path / version, "contact", version)
        names = sorted(path.name for path in folder.glob("*.c"))
        command = [executable, "-m", "ziglang", "cc", "-std=c99", "-c"]
        flags = ["-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Wconversion", "-Wno-sign-conversion"]
        # The header of FMI 3.0 has two functions without a prototype.
        flags += ["-Werror", "-Wno-strict-prototypes", "-Wno-deprecated-non-prototype"]
        result = subprocess.run([*command, *flags, *names], cwd=folder, capture_output=True, text=True)
        assert result.returncode == 0, result.stderr


@needs_compiler
def test_compiler_errors_are_reported(tmp_path):
    folder = write_sources(tmp_path / "sources", "contact", "2.0")
    with (folder / "model.c").open("a") as stream:
        stream.write("int broken(void) { return undeclared; }\n")
    with pytest.raises(BuildError) as caught:
        compile_library(folder, "contact", "2.0", ["x86_64-linux"])
    text = str(caught.value)
    assert text.startswith("C compiler, x86_64-linux: exit status 1\nmodel.c:")
    assert "use of undeclared identifier 'undeclared'" in text


@needs_compiler
def test_a_function_that_a_model_lacks_is_reported(tmp_path):
    folder = write_sources(tmp_path / "sources", "contact", "2.0")
    text = (folder / "model.c").read_text().replace("void model_tangent(", "void renamed(")
    (folder / "model.c").write_text(text)
    with pytest.raises(BuildError, match="model_tangent"):
        compile_library(folder, "contact", "2.0", ["x86_64-linux"])


@needs_compiler
def test_instances_have_no_mutable_globals():
    """No writable data of our own: what is there is constant after relocation, or the compiler's."""
    data = (unpacked("contact") / binary_member("x86_64-linux", "contact", "2.0")).read_bytes()
    sections_at = struct.unpack_from("<Q", data, 40)[0]
    size, count, names_index = struct.unpack_from("<3H", data, 58)
    sections = [struct.unpack_from("<IIQQQQ", data, sections_at + i * size) for i in range(count)]
    names = sections[names_index][4]
    sizes = {cstring(data, names + section[0]): section[5] for section in sections}
    assert sizes.get(".data", 0) == 0
    # One flag of the C start-up code.
    assert sizes.get(".bss", 0) <= 8


@pytest.mark.parametrize(
    ("platform", "version", "member"),
    [
        ("x86_64-linux", "2.0", "binaries/linux64/Model.so"),
        ("x86_64-windows", "2.0", "binaries/win64/Model.dll"),
        ("x86_64-darwin", "2.0", "binaries/darwin64/Model.dylib"),
        ("aarch64-darwin", "2.0", "binaries/darwin64/Model.dylib"),
        ("x86_64-linux", "3.0", "binaries/x86_64-linux/Model.so"),
        ("x86_64-windows", "3.0", "binaries/x86_64-windows/Model.dll"),
        ("x86_64-darwin", "3.0", "binaries/x86_64-darwin/Model.dylib"),
        ("aarch64-darwin", "3.0", "binaries/aarch64-darwin/Model.dylib"),
    ],
)
def test_places_of_the_binaries(platform, version, member):
    assert binary_member(platform, "Model", version) == member


def test_refusals():
    cases = [
        (
            lambda: binary_member("sparc", "Model", "2.0"),
            "unknown platform 'sparc'; known: x86_64-linux, x86_64-windows, x86_64-darwin, aarch64-darwin",
        ),
        (lambda: runtime_sources("1.0"), "unknown FMI version '1.0'; known: 2.0, 3.0"),
        (
            lambda: binary_member("x86_64-linux", "Not an identifier", "2.0"),
            "model identifier 'Not an identifier' is no C identifier; "
            "use letters, digits and underscores, no digit first",
        ),
        (
            lambda: write_fmu(Path("x.fmu"), {"../evil": b""}),
            "x.fmu: '../evil' is no path within an FMU; give a relative path with '/'",
        ),
    ]
    for call, message in cases:
        with pytest.raises(BuildError) as caught:
            call()
        assert str(caught.value) == message


def test_an_empty_folder_is_reported(tmp_path):
    with pytest.raises(BuildError, match="no C files to compile"):
        compile_library(tmp_path, "contact", "2.0", ["x86_64-linux"])


def test_sources_of_each_version():
    second, third = runtime_sources("2.0"), runtime_sources("3.0")
    assert {"fmi2.c", "fmi2Functions.h", "model.h", "runtime.h", "step.c"} <= set(second)
    assert not {name for name in second if name.startswith("fmi3")}
    assert {"fmi3.c", "fmi3_absent.c", "fmi3PlatformTypes.h"} <= set(third)
    assert not {name for name in third if name.startswith("fmi2")}
    assert "model.c" not in second
    description = build_description("Model", [*third, "model.c"]).decode()
    listed = re.findall(r'<SourceFile name="(.*?)"/>', description)
    assert listed == sorted([name for name in third if name.endswith(".c")] + ["model.c"])


def test_an_archive_depends_on_its_members_alone(tmp_path, monkeypatch):
    members = {"modelDescription.xml": b"<x/>" * 1000, "binaries/linux64/a.so": bytes(range(256)) * 50}
    first, second = tmp_path / "first.fmu", tmp_path / "second.fmu"
    write_fmu(first, members)
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    monkeypatch.setenv("TZ", "Pacific/Auckland")
    write_fmu(second, dict(reversed(members.items())))
    assert first.read_bytes() == second.read_bytes()
    with zipfile.ZipFile(first) as archive:
        assert archive.testzip() is None
        assert archive.namelist() == sorted(members)
        assert {name: archive.read(name) for name in members} == members
        for info in archive.infolist():
            assert (info.date_time, info.create_system, info.external_attr >> 16) == (
                (1980, 1, 1, 0, 0, 0),
                3,
                0o100644,
            )


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "x.fmu"
    write_fmu(path, {"a": b"1"})
    before = path.read_bytes()
    with pytest.raises(TypeError):
        write_fmu(path, {"a": b"2", "b": 3})
    assert path.read_bytes() == before
    assert [item.name for item in tmp_path.iterdir()] == ["x.fmu"]
