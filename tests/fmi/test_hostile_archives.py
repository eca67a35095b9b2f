"""Archives and documents that mean harm are refused before they do any."""

from __future__ import annotations

import struct
import tempfile
import zipfile
from time import process_time

import foreign
import pytest
from archives import repack

from orchestrator.base.errors import FmuError
from orchestrator.cli.main import main
from orchestrator.fmi import archive, load_fmu

LAUGHS = """<!DOCTYPE fmi [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">
<!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;"><!ENTITY d "&c;&c;&c;&c;&c;&c;&c;&c;">]>
<fmiModelDescription fmiVersion="3.0" modelName="&d;"/>"""
OUTSIDE = (
    '<!DOCTYPE fmi [<!ENTITY a SYSTEM "file:///etc/passwd">]>'
    '<fmiModelDescription fmiVersion="3.0">&a;</fmiModelDescription>'
)
REMOTE = '<!DOCTYPE fmi SYSTEM "http://localhost:9/x.dtd"><fmiModelDescription fmiVersion="3.0"/>'
DOCUMENTS = {"laughs": LAUGHS, "outside": OUTSIDE, "remote": REMOTE}


def refusal(path):
    with pytest.raises(FmuError) as caught:
        load_fmu(path).instantiate("one")
    return str(caught.value).replace(str(path), "X.fmu")


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("document", DOCUMENTS)
def test_document_types_are_refused_in_any_encoding(document, encoding, tmp_path):
    path = tmp_path / "X.fmu"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("modelDescription.xml", DOCUMENTS[document].encode(encoding))
    assert refusal(path) == (
        "X.fmu: modelDescription.xml declares a document type, which FMI has no use for; refused"
    )


def test_an_encoding_that_hides_a_document_type_is_refused(tmp_path):
    path = tmp_path / "X.fmu"
    with zipfile.ZipFile(path, "w") as file:
        text = '<?xml version="1.0" encoding="UTF-7"?>' + OUTSIDE
        file.writestr("modelDescription.xml", text.encode("utf-7"))
    assert refusal(path).startswith("X.fmu: modelDescription.xml is in an encoding that is not read here (")


@pytest.mark.parametrize("document", DOCUMENTS)
def test_the_build_description_is_looked_at_too(document, tmp_path):
    path = foreign.arrays(tmp_path / "X.fmu")
    with zipfile.ZipFile(path, "a") as file:
        file.writestr("sources/buildDescription.xml", DOCUMENTS[document])
    assert refusal(path) == (
        "X.fmu: sources/buildDescription.xml declares a document type, which FMI has no use for; refused"
    )


def test_an_archive_that_expands_too_far_is_refused(tmp_path):
    path = foreign.arrays(tmp_path / "X.fmu")
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as file, file.open("resources/zeros", "w") as entry:
        for _ in range(300):
            entry.write(bytes(2**20))
    packed, size = path.stat().st_size, sum(one.file_size for one in zipfile.ZipFile(path).infolist())
    assert packed < 2**20
    assert refusal(path) == (
        f"X.fmu: refused, its {packed} bytes unpack to {size}; at most 200 times the archive, or "
        f"268435456 bytes, are accepted"
    )


@pytest.mark.parametrize("filler", [b" ", b"<Category/>"])
def test_a_description_that_expands_too_far_is_refused_before_it_is_read(filler, tmp_path):
    """Long before an archive of so little would count as a bomb: markup costs hundreds of times its text."""
    path, made = foreign.arrays(tmp_path / "X.fmu"), tmp_path / "made.fmu"
    with zipfile.ZipFile(path) as file, zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as new:
        for name in file.namelist():
            more = filler * (32 * 2**20 // len(filler)) if name == "modelDescription.xml" else b""
            new.writestr(name, file.read(name) + more)
    entry = zipfile.ZipFile(made).getinfo("modelDescription.xml")
    begin = process_time()
    assert refusal(made) == (
        f"X.fmu: refused, the {entry.compress_size} bytes of modelDescription.xml unpack to "
        f"{entry.file_size}; at most 100 times as many, or 4194304 bytes, and 536870912 bytes, are accepted"
    )
    assert process_time() - begin < 10.0


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_methods_that_unpack_without_bounds_are_refused(method, tmp_path):
    path = foreign.arrays(tmp_path / "X.fmu")
    with zipfile.ZipFile(path, "a", method) as file:
        file.writestr("resources/zeros", bytes(2**20))
    assert refusal(path) == (
        f"X.fmu: refused, its entry 'resources/zeros' is packed by method {method}\n"
        "  allowed: stored (0) and deflated (8)"
    )


@pytest.mark.parametrize("entry", ["modelDescription.xml", "binaries/"])
def test_content_that_is_no_deflate_is_refused(entry, tmp_path):
    path, made = foreign.arrays(tmp_path / "X.fmu"), tmp_path / "made.fmu"
    with zipfile.ZipFile(path) as file, zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as new:
        for name in file.namelist():
            new.writestr(name, file.read(name))
        broken = next(one for one in new.infolist() if one.filename.startswith(entry))
    data = bytearray(made.read_bytes())
    begin = broken.header_offset + 30 + len(broken.filename)
    data[begin : begin + 20] = b"\x07" + b"\xff" * 19
    made.write_bytes(data)
    assert "Error -3 while decompressing data" in refusal(made)
    assert main(["check", str(made)]) == (2 if entry == "modelDescription.xml" else 0)
    assert main(["run", str(made)]) in (1, 2)


def test_a_size_that_is_understated_does_not_help(tmp_path):
    """What an entry holds beyond the size that it declares is never written."""
    path = foreign.arrays(tmp_path / "X.fmu")
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as file:
        file.writestr("resources/zeros", bytes(2**20))
    data = path.read_bytes()
    place = data.rindex(b"PK\x01\x02")  # the last entry of the directory, its size 24 bytes further on
    assert struct.unpack_from("<I", data, place + 24)[0] == 2**20
    path.write_bytes(data[: place + 24] + struct.pack("<I", 10) + data[place + 28 :])
    assert refusal(path).startswith("X.fmu: cannot be unpacked (Bad CRC-32")


def test_too_many_entries_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(archive, "MOST_ENTRIES", 5)
    path = foreign.arrays(tmp_path / "X.fmu")
    with zipfile.ZipFile(path, "a") as file:
        for number in range(4):
            file.writestr(f"resources/{number}", "")
    assert refusal(path) == "X.fmu: refused, it has 6 entries; at most 5 are accepted"


def test_what_the_disk_cannot_hold_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(archive.shutil, "disk_usage", lambda folder: type("Usage", (), {"free": 100}))
    path = foreign.arrays(tmp_path / "X.fmu")
    message = refusal(path)
    assert message.startswith("X.fmu: cannot be unpacked, it needs ") and message.endswith(" has 100")


def test_an_entry_without_a_name_is_refused(tmp_path):
    path = foreign.arrays(tmp_path / "X.fmu")
    with zipfile.ZipFile(path, "a") as file:
        file.writestr(".", "x")
    assert refusal(path) == "X.fmu: refused, its entry '.' would be written elsewhere"


def test_entries_that_would_be_written_to_one_file_are_refused(tmp_path):
    path = foreign.arrays(tmp_path / "X.fmu")
    with zipfile.ZipFile(path, "a") as file:
        file.writestr("resources/Table.txt", "1")
        file.writestr("resources/table.TXT", "2")
    assert refusal(path) == (
        "X.fmu: refused, its entries 'resources/Table.txt' and 'resources/table.TXT' would be written to one "
        "file, and differ"
    )


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_the_same_file_twice_is_taken_and_two_of_one_name_are_not(tmp_path):
    path = foreign.arrays(tmp_path / "X.fmu")
    library = next(name for name in zipfile.ZipFile(path).namelist() if name.startswith("binaries/"))
    with zipfile.ZipFile(path, "a") as file:
        file.writestr(library, file.read(library))
    load_fmu(path).instantiate("one").free()
    with zipfile.ZipFile(path, "a") as file:
        file.writestr(library, b"another one")
    assert refusal(path) == (
        f"X.fmu: refused, its entries {library!r} and {library!r} would be written to one file, and differ"
    )


def test_a_file_that_is_a_folder_as_well_is_refused(tmp_path):
    path = foreign.arrays(tmp_path / "X.fmu")
    with zipfile.ZipFile(path, "a") as file:
        file.writestr("resources/one", "x")
        file.writestr("resources/one/two", "x")
    assert refusal(path) == (
        "X.fmu: refused, its entry 'resources/one' is a file, and a folder of 'resources/one/two'"
    )


def snapshot(folder):
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*")}


def truncated(path):
    path.write_bytes(path.read_bytes()[:-200])


def damaged(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF  # within the library, by far the largest entry
    path.write_bytes(data)


def climbing(path):
    with zipfile.ZipFile(path, "a") as file:
        file.writestr("resources/../../../escaped.txt", "x")


def absolute(path):
    with zipfile.ZipFile(path, "a") as file:
        file.writestr(str(path.parent / "escaped.txt"), "x")


def linked(path):
    with zipfile.ZipFile(path, "a") as file:
        link = zipfile.ZipInfo("resources/link")
        link.external_attr = 0o120777 << 16
        file.writestr(link, "/etc")


def without_description(path):
    repack(path, path.with_suffix(".new"), lambda name, data: None if name.endswith(".xml") else (name, data))
    path.with_suffix(".new").replace(path)


def without_library(path):
    repack(path, path.with_suffix(".new"), lambda name, data: None if "binaries" in name else (name, data))
    path.with_suffix(".new").replace(path)


def of_another_build(path):
    def change(name, data):
        return name, data.replace(b'guid="none"', b'guid="{0}"')

    repack(path, path.with_suffix(".new"), change)
    path.with_suffix(".new").replace(path)


BROKEN = {
    truncated: "X.fmu: not an FMU, since it is no zip archive (",
    damaged: "X.fmu: cannot be unpacked (Bad CRC-32",
    climbing: "X.fmu: refused, its entry 'resources/../../../escaped.txt' would be written elsewhere",
    absolute: "X.fmu: refused, its entry ",
    linked: "X.fmu: refused, its entry 'resources/link' is a symbolic link",
    without_description: "X.fmu: not an FMU, it has no modelDescription.xml at the top",
    without_library: "X.fmu: no binary for this platform, ",
    of_another_build: "X.fmu: instance one could not be made",
}


@pytest.mark.parametrize("harm", BROKEN, ids=lambda harm: harm.__name__)
def test_a_broken_fmu_is_refused_and_leaves_nothing(harm, tmp_path, monkeypatch):
    folder, scratch = tmp_path / "given", tmp_path / "scratch"
    folder.mkdir()
    scratch.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(scratch))
    path = foreign.flawed(folder / "X.fmu")
    harm(path)
    before = snapshot(tmp_path)
    assert refusal(path).startswith(BROKEN[harm])
    after = snapshot(tmp_path)
    assert not list(scratch.glob("*/fmu-*"))  # it was used, and holds nothing but the lock
    assert {path: one for path, one in after.items() if scratch not in (path, *path.parents)} == {
        path: one for path, one in before.items() if path != scratch
    }
