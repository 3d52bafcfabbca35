"""XML files changed attribute by attribute: comments, order and white space stay as their author wrote them."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from leactl.errors import InputError
from leactl.regular_files import file_bytes

MOST_FILE_BYTES = 1 << 24  # bytes of the largest file that is read
_ATTRIBUTE = re.compile(r"""\s+([^\s=/>"']+)\s*=\s*("[^"]*"|'[^']*')""")


@dataclass(frozen=True)
class Element:
    """The start tag of one element."""

    path: tuple[str, ...]  # names from the root to the element
    attributes: Mapping[str, str]
    begin: int  # index of the byte of its `<` in the file
    end: int  # index of the byte after its `>`
    parent: int | None  # index of the element around it; None of the outermost element

    @property
    def name(self) -> str:
        """Name of the element."""
        return self.path[-1]


@dataclass(frozen=True)
class XmlText:
    """An XML file as bytes, with the position of each element."""

    name: str
    raw: bytes
    elements: tuple[Element, ...]

    @property
    def root(self) -> str:
        """Name of the outermost element."""
        return self.elements[0].name

    def line(self, element: Element) -> int:
        """Return the line on which an element begins, from 1."""
        return self.raw.count(b"\n", 0, element.begin) + 1

    def children(self, element: Element) -> Iterator[Element]:
        """Return the children of an element."""
        index = self.elements.index(element)
        return (child for child in self.elements if child.parent == index)

    def changed(self, changes: Mapping[int, Mapping[str, str | None]], new_children: Mapping[int, str]) -> bytes:
        """Return the file with attributes of some elements set, or removed if they are None.

        Parameters
        ----------
        changes : attributes by the index of their element.
        new_children : text of a new first child, by the index of its parent.
        """
        parts, copied_end = [], 0
        for index in sorted({*changes, *new_children}):
            element = self.elements[index]
            parts.append(self.raw[copied_end : element.begin])
            tag = self.raw[element.begin : element.end].decode("utf-8")
            for name, value in changes.get(index, {}).items():
                tag = _with_attribute(tag, name, value)
            parts.append(tag.encode("utf-8"))
            copied_end = element.end
            if index in new_children:
                parts.append((_break_before(self.raw, element) + new_children[index]).encode("utf-8"))
        return b"".join([*parts, self.raw[copied_end:]])


def read_xml(path: Path) -> XmlText:
    """Return an XML file with the positions of its elements.

    Raises
    ------
    InputError : the file is absent, no regular file, larger than 16 MiB, not UTF-8, no XML, or declares a document
        type.
    """
    return parse_xml(file_bytes(path, MOST_FILE_BYTES), str(path))


def parse_xml(raw: bytes, name: str) -> XmlText:
    """Return the elements of XML bytes; errors name the file as `name`.

    Raises
    ------
    InputError : the bytes are not UTF-8, no XML, or declare a document type, whose entities could grow without end.
    """
    try:
        raw.decode("utf-8")
    except UnicodeDecodeError as fault:
        raise InputError(f"{name}: not UTF-8 at byte {fault.start}") from None
    elements: list[Element] = []
    open_elements: list[int] = []
    parser = expat.ParserCreate("utf-8")

    def begin(tag: str, attributes: dict[str, str]) -> None:
        parent = open_elements[-1] if open_elements else None
        path = (*(elements[parent].path if parent is not None else ()), tag)
        tag_begin = parser.CurrentByteIndex
        open_elements.append(len(elements))
        elements.append(Element(path, attributes, tag_begin, _end_of_tag(raw, tag_begin), parent))

    def refuse_document_type(*_: object) -> None:
        raise InputError(f"{name}:{parser.CurrentLineNumber}:1  <!DOCTYPE> is not accepted")

    parser.StartElementHandler = begin
    parser.EndElementHandler = lambda _: open_elements.pop()
    parser.StartDoctypeDeclHandler = refuse_document_type
    try:
        parser.Parse(raw, True)
    except expat.ExpatError as fault:
        raise InputError(f"{name}:{fault.lineno}:{fault.offset + 1}  no XML: {expat.ErrorString(fault.code)}") from None
    return XmlText(name, raw, tuple(elements))


def _end_of_tag(raw: bytes, begin: int) -> int:
    """Return the index behind the `>` that ends a start tag; a `>` in a quoted value does not count."""
    quote = b""
    for index in range(begin, len(raw)):
        char = raw[index : index + 1]
        if quote:
            quote = b"" if char == quote else quote
        elif char in (b'"', b"'"):
            quote = char
        elif char == b">":
            return index + 1
    return len(raw)  # the tag has no end, for which the parser raises an error


def _with_attribute(tag: str, name: str, value: str | None) -> str:
    """Return a start tag with an attribute set, or removed if the value is None."""
    for match in _ATTRIBUTE.finditer(tag):
        if match[1] == name:
            text_before, text_after = tag[: match.start()], tag[match.end() :]
            if value is None:
                return text_before + text_after
            name_part = tag[match.start() : match.start(2)]
            return text_before + name_part + quoteattr(value) + text_after
    if value is None:
        return tag
    head = tag.rstrip(">").rstrip("/").rstrip()
    return f"{head} {name}={quoteattr(value)}{tag[len(head) :].lstrip()}"


def _break_before(raw: bytes, element: Element) -> str:
    """Return the line break and indentation before an element's first child: two spaces more than its own."""
    text_before = raw[raw.rfind(b"\n", 0, element.begin) + 1 : element.begin].decode("utf-8")
    return "\n" + (text_before if not text_before.strip() else "") + "  "
