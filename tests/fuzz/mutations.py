"""Changes to files that make them odd, broken or hostile; all follow from the given source of chance."""

# ruff: noqa: E501, RUF001 (tables of odd text)

from __future__ import annotations

import gzip
import io
import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from random import Random
from typing import Any

import yaml

__all__ = ["archive_changed", "packed_changed", "text_changed", "xml_changed", "yaml_changed"]

NUMBERS = (
    "0", "-0.0", "1", "-1", "2", "1e-300", "1e300", "-1e300", "1e308", "1e400", "1e-400", "nan", ".inf", "-inf",
    "4294967296", "9223372036854775808", "-2147483649", "9" * 40, "9" * 1200, "1e", "0x10", "1_000", "007", "١",
)  # fmt: skip
WORDS = (
    "", " ", "null", "true", "false", "~", "[]", "{}", "*a", "&a", "!!python/object:os.system", "---", "?", "|",
    "é", "\u202e", "\ud7ff", "😀", "\t", "a" * 5000, "../../etc/passwd", "/dev/zero", "CON", "C:\\x", "%s%n",
    "1 m", "1 m/s^99", "s", "m^m", "1 kg.m2/s-3", "a.b", "a.b[1]", "a[-1]", "a[99999999999]", "$(id)", "`id`",
    "__class__", "-", "->", "a.b -> c.d", "<a>", "&lt;", "]]>", "\\", '"', "'",
)  # fmt: skip
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
_WORD = re.compile(r"[A-Za-z_][\w.-]*")
_TOKEN = re.compile(r"\w+|[^\w\s]|\s+")


def text_changed(random: Random, data: bytes, times: int = 1) -> bytes:
    """A text with words, numbers, lines or bytes that are changed."""
    for _ in range(times):
        data = random.choice(_TEXT)(random, data)
    return data


def _span(random: Random, size: int, most: int = 200) -> slice:
    begin = random.randrange(size + 1)
    return slice(begin, min(size, begin + random.randint(1, most)))


def _flipped(random: Random, data: bytes) -> bytes:
    found = bytearray(data or b"x")
    for _ in range(random.choice((1, 1, 1, 4, 20))):
        found[random.randrange(len(found))] = random.randrange(256)
    return bytes(found)


def _cut(random: Random, data: bytes) -> bytes:
    return data[: random.randrange(len(data) + 1)]


def _without(random: Random, data: bytes) -> bytes:
    span = _span(random, len(data))
    return data[: span.start] + data[span.stop :]


def _repeated(random: Random, data: bytes) -> bytes:
    span = _span(random, len(data))
    return data[: span.stop] + data[span] * random.choice((1, 1, 2, 300)) + data[span.stop :]


def _inserted(random: Random, data: bytes) -> bytes:
    place = random.randrange(len(data) + 1)
    word = random.choice(WORDS + NUMBERS).encode("utf-8", "surrogatepass")
    return data[:place] + word + data[place:]


def _replaced(random: Random, data: bytes) -> bytes:
    """A number or word for another, of those that the text has or of odd ones."""
    text = data.decode("utf-8", "replace")
    pattern, odd = random.choice(((_NUMBER, NUMBERS), (_WORD, WORDS)))
    found = list(pattern.finditer(text))
    if not found:
        return _inserted(random, data)
    one = random.choice(found)
    new = random.choice(found)[0] if random.random() < 0.5 else random.choice(odd)
    return (text[: one.start()] + new + text[one.end() :]).encode("utf-8", "surrogatepass")


def _tokens(random: Random, data: bytes) -> bytes:
    """A token dropped, doubled or swapped with another."""
    found = _TOKEN.findall(data.decode("utf-8", "replace"))
    if len(found) < 2:
        return data
    one, other = random.randrange(len(found)), random.randrange(len(found))
    match random.randrange(3):
        case 0:
            del found[one]
        case 1:
            found.insert(one, found[one])
        case _:
            found[one], found[other] = found[other], found[one]
    return "".join(found).encode()


def _lines(random: Random, data: bytes) -> bytes:
    """A line dropped, doubled, moved or indented otherwise."""
    lines = data.splitlines(keepends=True) or [b""]
    one, other = random.randrange(len(lines)), random.randrange(len(lines))
    match random.randrange(4):
        case 0:
            del lines[one]
        case 1:
            lines.insert(other, lines[one])
        case 2:
            lines[one], lines[other] = lines[other], lines[one]
        case _:
            lines[one] = b" " * random.randint(1, 4) + lines[one]
    return b"".join(lines)


def _encoded(random: Random, data: bytes) -> bytes:
    text = data.decode("utf-8", "replace")
    return text.encode(random.choice(("utf-16", "utf-8-sig", "utf-32", "latin-1", "utf-7")), "replace")


_TEXT: tuple[Callable[[Random, bytes], bytes], ...] = (
    _flipped, _cut, _without, _repeated, _inserted, _encoded,
    *[_replaced] * 6, *[_tokens] * 3, *[_lines] * 3,
)  # fmt: skip


def yaml_changed(random: Random, data: bytes) -> bytes:
    """A YAML text, changed in its values and keys, or as any text."""
    if random.random() < 0.35:
        return text_changed(random, data, random.choice((1, 1, 2, 3)))
    value = yaml.safe_load(data)
    for _ in range(random.choice((1, 1, 1, 2, 4))):
        value = _tree_changed(random, value)
    return yaml.safe_dump(value, sort_keys=False, allow_unicode=True).encode()


def _places(value: Any) -> list[tuple[Any, Any]]:
    """Each place in a tree: what holds it, and its key or index there."""
    found: list[tuple[Any, Any]] = []
    waiting = [value]
    while waiting:
        one = waiting.pop()
        pairs = one.items() if isinstance(one, dict) else enumerate(one) if isinstance(one, list) else ()
        for key, inner in pairs:
            found.append((one, key))
            waiting.append(inner)
    return found


def _odd(random: Random) -> Any:
    number = random.choice(NUMBERS)
    return random.choice((
        random.choice(WORDS), number, f"{number} {random.choice(('s', 'm', 'N', 'kg', 'Hz', '1', 'V'))}",
        None, True, False, 0, -1, 1, 1.5, 10**18, -(10**30), 1e-300, 1e300, float("inf"), float("nan"), [], {},
        [[]], {"": None}, [None], {"a": {"b": ["c"]}}, ["x"] * 500,
    ))  # fmt: skip


def _tree_changed(random: Random, value: Any) -> Any:
    places = _places(value)
    if not places:
        return _odd(random)
    holder, key = random.choice(places)
    other, at = random.choice(places)
    match random.randrange(9):
        case 0 | 1:
            holder[key] = _odd(random)
        case 2:
            del holder[key]
        case 3:
            holder[key] = _plain(other[at])
        case 4:
            holder[key] = [holder[key]]
        case 5 if isinstance(holder, dict):
            name = random.choice((str(at), random.choice(WORDS), f"{key}x", 1))
            holder[name] = holder.pop(key)
        case 6 if isinstance(holder, list):
            holder.extend(_plain(holder[key]) for _ in range(random.choice((1, 1, 50))))
        case 7 if isinstance(holder[key], int | float):
            factor = random.choice((0, -1, 0.5, 2, 1e-9, 1e9, 1e-200, 1e200))
            holder[key] = holder[key] * factor
        case _ if isinstance(holder[key], str):
            holder[key] = _replaced(random, holder[key].encode()).decode("utf-8", "replace")
        case _:
            holder[key] = _odd(random)
    return value


def _plain(value: Any) -> Any:
    """A copy, which does not hold what it will stand in."""
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    return [_plain(one) for one in value] if isinstance(value, list) else value


_TYPES = (
    '<!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>',
    '<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]>',
    '<!DOCTYPE x SYSTEM "http://localhost:9/x.dtd">',
)


def xml_changed(random: Random, data: bytes) -> bytes:
    """An XML text, changed in its elements and attributes, or as any text; with a document type, seldom."""
    if random.random() < 0.25:
        return text_changed(random, data, random.choice((1, 1, 2, 3)))
    from lxml import etree

    try:
        root = etree.fromstring(data)
    except etree.XMLSyntaxError:
        return text_changed(random, data)
    for _ in range(random.choice((1, 1, 1, 2, 4))):
        _element_changed(random, root)
    text = etree.tostring(root)
    return random.choice(_TYPES).encode() + text if random.random() < 0.03 else text


def _element_changed(random: Random, root: Any) -> None:
    elements = [one for one in root.iter() if isinstance(one.tag, str)]
    one, other = random.choice(elements), random.choice(elements)
    names = list(one.attrib)
    kind = random.randrange(9)
    if kind <= 3 and names:
        name = random.choice(names)
        odd = random.choice(NUMBERS) if random.random() < 0.5 else random.choice(WORDS)
        values = [odd, *other.attrib.values()]
        values += [
            each.get(name) for each in random.sample(elements, min(20, len(elements))) if each.get(name)
        ]
        one.set(name, _legal(random.choice(values)))
    elif kind == 4 and names:
        del one.attrib[random.choice(names)]
    elif kind == 5 and other.attrib:
        name = random.choice(list(other.attrib))
        one.set(name, other.get(name))
    elif kind == 6 and one.getparent() is not None:
        one.getparent().remove(one)
    elif kind == 7 and one.getparent() is not None:
        parent = one.getparent()
        for _ in range(random.choice((1, 1, 1, 200))):
            parent.insert(random.randrange(len(parent) + 1), _copied(one))
    elif one is not other and one.getparent() is not None and one not in other.iterancestors():
        other.append(one)
    elif not names:
        one.text = _legal(random.choice(WORDS + NUMBERS))
    else:
        one.tag = other.tag


def _copied(element: Any) -> Any:
    from copy import deepcopy

    return deepcopy(element)


def _legal(text: str) -> str:
    """What XML can hold."""
    return "".join(one for one in text if one in "\t\n" or " " <= one <= "\ud7ff" or one > "\uffff")


NAMES = (
    "../escaped.txt", "../../escaped.txt", "resources/../../../escaped.txt", "/escaped.txt", "C:/escaped.txt",
    "..\\escaped.txt", "resources/", "", ".", "a" * 300, "resources/" + "x/" * 300 + "y", "resources/\u202e.txt",
    "binaries/linux64/x.so", "modelDescription.xml", "MODELDESCRIPTION.XML", "SystemStructure.ssd", "\x00", "é",
)  # fmt: skip


def archive_changed(
    random: Random, data: bytes, outside: str, changed: Callable[[Random, str, bytes], bytes]
) -> bytes:
    """A zip archive, changed in its bytes, table of contents or entries.

    Args:
        outside: absolute path of a file that nobody may write.
        changed: gives an entry's new content, by its name.
    """
    kind = random.random()
    if kind < 0.15:
        return random.choice((_flipped, _cut, _without, _repeated, _inserted))(random, data)
    if kind < 0.35:
        return _directory_changed(random, data)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        entries = [(one, archive.read(one)) for one in archive.infolist()]
    for _ in range(random.choice((1, 1, 1, 2))):
        _entries_changed(random, entries, outside, changed)
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as archive:
        for info, content in entries:
            archive.writestr(info, content)
    return _damaged(random, made.getvalue()) if random.random() < 0.1 else made.getvalue()


def _damaged(random: Random, data: bytes) -> bytes:
    """An archive of deflated entries, one of them damaged within."""
    made = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as archive, zipfile.ZipFile(made, "w") as packed:
        for info in archive.infolist():
            packed.writestr(info, archive.read(info), zipfile.ZIP_DEFLATED)
        entries = [one for one in packed.infolist() if one.compress_size]
    found = bytearray(made.getvalue())
    if not entries:
        return bytes(found)
    one = random.choice(entries)
    begin = one.header_offset + 30 + len(one.filename.encode())
    for _ in range(random.choice((1, 4, 20))):
        found[begin + random.randrange(one.compress_size)] = random.randrange(256)
    return bytes(found)


def packed_changed(random: Random, data: bytes) -> bytes:
    """A text packed by gzip: its bytes or the text in it changed, several in one, or far larger than packed."""
    match random.randrange(8):
        case 0 | 1:
            return random.choice((_flipped, _cut, _without, _repeated, _inserted))(random, data)
        case 2:
            return data + random.choice((data, b"\0" * 100, b"x", gzip.compress(b"1,2,3\n")))
        case 3:
            piece = random.choice((b"\0", b"\n", b",", b"0,0,0\n", b'"', b"a,b,c\n"))
            return gzip.compress(gzip.decompress(data) + piece * (2**26 // len(piece)), 1)
        case _:
            return gzip.compress(text_changed(random, gzip.decompress(data)), 1)


def _entries_changed(
    random: Random,
    entries: list[tuple[zipfile.ZipInfo, bytes]],
    outside: str,
    changed: Callable[[Random, str, bytes], bytes],
) -> None:
    if not entries:
        return
    at = random.randrange(len(entries))
    info, content = entries[at]
    new = zipfile.ZipInfo(random.choice((*NAMES, outside)))
    match random.randrange(11):
        case 0 | 1 | 2:
            written = [
                one for one in range(len(entries)) if entries[one][0].filename.endswith((".xml", ".ssd"))
            ]
            at = random.choice(written or [at])
            info, content = entries[at]
            entries[at] = info, changed(random, info.filename, content)
        case 3:
            entries[at] = info, changed(random, info.filename, content)
        case 4:
            del entries[at]
        case 5:
            new.external_attr = info.external_attr
            entries[at] = new, content
        case 6:
            new.external_attr = random.choice((0o120777, 0o040755, 0o010644, 0o060644, 0)) << 16
            entries.append((new, random.choice((b"", b"/etc/passwd", b"../../escaped.txt", content[:1000]))))
        case 7:
            info.compress_type = random.choice((zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA))
        case 8:  # far larger than it is packed
            info.compress_type = zipfile.ZIP_DEFLATED
            entries[at] = info, content + random.choice((b" ", b"\n", b"\0")) * (2**25)
        case _:
            new.compress_type = zipfile.ZIP_DEFLATED
            entries.append((new, bytes(random.choice((10, 2**20, 2**23)))))


def _directory_changed(random: Random, data: bytes) -> bytes:
    """Fields of an entry in the table of contents or before its content: method, flags, sizes, offset, name."""
    found = bytearray(data)
    mark, shift = random.choice(((b"PK\x01\x02", 2), (b"PK\x03\x04", 0)))
    places = [one.start() for one in re.finditer(re.escape(mark), data)]
    if not places:
        return _flipped(random, data)
    place = random.choice(places)
    # After Zip's APPNOTE 4.3.7 and 4.3.12: version, flags, method, time, date, CRC, sizes, lengths.
    field, form = random.choice((
        (4 + shift, "<H"), (6 + shift, "<H"), (8 + shift, "<H"), (14 + shift, "<I"), (18 + shift, "<I"),
        (22 + shift, "<I"), (26 + shift, "<H"), (28 + shift, "<H"), (30, "<H") if shift else (26, "<H"),
        (38, "<I") if shift else (14, "<I"), (42, "<I") if shift else (18, "<I"), (46 if shift else 30, "<B"),
    ))  # fmt: skip
    size = struct.calcsize(form)
    old = int.from_bytes(found[place + field : place + field + size], "little")
    values = (0, 1, old + 1, old - 1, 2 * old, 256**size - 1, random.getrandbits(8 * size), zlib.crc32(data))
    new = random.choice(values) % 256**size
    found[place + field : place + field + size] = new.to_bytes(size, "little")
    return bytes(found)
