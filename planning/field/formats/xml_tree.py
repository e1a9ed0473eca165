"""XML without entity declarations, in any encoding, as a tree of elements without name spaces."""

import codecs
from contextlib import suppress
from typing import Any, NoReturn
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from messages.errors import FieldError

MAX_DEPTH = 200
MAX_ELEMENTS = 500_000
MISLABELLED = (expat.errors.XML_ERROR_INVALID_TOKEN, expat.errors.XML_ERROR_INCORRECT_ENCODING)
UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def is_xml(head: bytes) -> bool:
    """True if a file begins as XML does, in UTF-8 or UTF-16, with or without a byte order mark."""
    plain = head.removeprefix(codecs.BOM_UTF8).lstrip()
    return plain.startswith((b"<", b"\x00<")) or head.startswith((*(b + b"<" for b in UTF_16), b"\xfe\xff\x00<"))


def parse_xml(data: bytes, name: str) -> Element:
    """Root of a document; tags and attributes lose their prefixes. Raises FieldError that names `name`.

    A document whose declared encoding is not its own is read in its own: names are often in another encoding.
    """
    data = data if data.startswith(UTF_16) else data.lstrip()
    try:
        return _tree(data, name)
    except expat.ExpatError as error:
        reason = expat.errors.messages.get(error.code)
        if reason in MISLABELLED and (text := _decoded(data)) is not None:
            with suppress(expat.ExpatError):
                return _tree(text, name)
        raise FieldError(f"{name}: not valid XML ({error}); export the file again") from error
    except (LookupError, ValueError) as error:
        raise FieldError(f"{name}: unreadable XML ({error}); export it in UTF-8") from error


def local(tag: str) -> str:
    """Name without its prefix."""
    return tag.rpartition(":")[2]


def _decoded(data: bytes) -> str | None:
    """Text in UTF-16, UTF-8 or else ISO 8859-1."""
    encodings = ("utf-16",) if data.startswith(UTF_16) else ("utf-8-sig", "iso-8859-1")
    for encoding in encodings:
        with suppress(UnicodeDecodeError):
            return data.decode(encoding)
    return None


def _tree(data: bytes | str, name: str) -> Element:
    builder, depth, count = TreeBuilder(), 0, 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, count
        depth, count = depth + 1, count + 1
        if depth > MAX_DEPTH or count > MAX_ELEMENTS:
            raise FieldError(f"{name}: more than {MAX_DEPTH} levels or {MAX_ELEMENTS} elements of XML")
        builder.start(local(tag), {local(key): value for key, value in attributes.items()})

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(local(tag))

    def refuse(entity: str, *_: Any) -> NoReturn:
        raise FieldError(f"{name}: declares the XML entity {entity!r}; export the field without a DTD")

    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = builder.data
    parser.EntityDeclHandler = refuse
    parser.Parse(data, True)
    return builder.close()
