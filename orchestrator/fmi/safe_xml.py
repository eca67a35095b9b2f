"""XML of an FMU, read without trusting it.

A document type is refused before anything of it is acted on: it is the only way to declare entities, hence
to blow a document up (billion laughs) or to draw other files into it (external entities), and FMI needs none.
"""

from __future__ import annotations

import io
import zipfile
import zlib
from pathlib import Path
from typing import Any
from xml.parsers import expat

from ..base.errors import FmuError
from .archive import check_document, check_members

_REFUSED = "{path}: {name} declares a document type, which {standard} has no use for; refused"
# Read by fmpy besides the model description.
_FURTHER = ("sources/buildDescription.xml",)


def read_markup(path: Path) -> Any:
    """Root element (lxml) of modelDescription.xml, after a look at all XML that will be read.

    Raises: FmuError if it is missing, too large, malformed, or has a document type, or if the archive has
        entries that would harm.
    """
    name = "modelDescription.xml"
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            check_members(path, path.stat().st_size, members)
            names = [member.filename for member in members]
            if name not in names:
                content = ", ".join(names[:10]) or "nothing"
                raise FmuError(f"{path}: not an FMU, it has no {name} at the top\n  it holds {content}")
            xml = _read(path, archive, name)
            for other in _FURTHER:
                if other in names:
                    _refuse_document_type(path, other, _read(path, archive, other))
    except zipfile.BadZipFile as error:
        raise FmuError(
            f"{path}: not an FMU, since it is no zip archive ({error})\n  Export or download it again."
        ) from error
    except (OSError, RuntimeError, NotImplementedError, EOFError, zlib.error, ValueError) as error:
        raise FmuError(f"{path}: cannot be read ({error})") from error
    return parse_markup(path, name, xml)


def parse_markup(path: Path | str, name: str, xml: bytes, standard: str = "FMI") -> Any:
    """Root element (lxml) of an XML file.

    Args:
        path, name: of the archive and of the file in it, for messages.
        standard: which the file follows.
    Raises: FmuError if it is malformed, or has a document type.
    """
    _refuse_document_type(path, name, xml, standard)
    return _parse(path, name, xml, standard)


def _read(path: Path, archive: zipfile.ZipFile, name: str) -> bytes:
    check_document(path, archive.getinfo(name))
    return archive.read(name)


class _DocumentType(Exception):
    pass


def _refuse_document_type(path: Path | str, name: str, xml: bytes, standard: str = "FMI") -> None:
    # By a parser, not by a search for "<!DOCTYPE": in UTF-16 that word is spelt with other bytes.
    def found(*_: Any) -> None:
        raise _DocumentType

    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = found
    parser.EntityDeclHandler = found
    try:
        parser.Parse(xml, True)
    except _DocumentType:
        raise FmuError(_REFUSED.format(path=path, name=name, standard=standard)) from None
    except (expat.ExpatError, ValueError, LookupError) as error:
        if "encoding" in str(error):
            raise FmuError(f"{path}: {name} is in an encoding that is not read here ({error})") from error
        # Malformed: the reader that follows says where.


def _parse(path: Path | str, name: str, xml: bytes, standard: str) -> Any:
    from lxml import etree

    try:
        parser = etree.XMLParser(resolve_entities=False, no_network=True)
        tree = etree.parse(io.BytesIO(xml), parser)
    except etree.XMLSyntaxError as error:
        raise FmuError(f"{path}: {name} is not well-formed XML ({error.msg})") from error
    if tree.docinfo.doctype:
        raise FmuError(_REFUSED.format(path=path, name=name, standard=standard))
    return tree.getroot()
