"""Read a robot description's XML, and refuse DOCTYPE, entities and oversized text."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

from lxml import etree

from denoc_ros.errors import ModelError
from denoc_ros.model.reading.findings import Element

LARGEST_TEXT = 8 * 1024 * 1024  # bytes; the largest robots in use have a tenth of it
TEXT_NAME = 'robot description'
READ_ELEMENTS = ('link', 'joint', 'material', 'flexibility')  # of a robot; the others are not


def read_source(source: str | os.PathLike[str]) -> tuple[str, str]:
    """Return where a robot description comes from, and its text.

    Returns
    -------
    where : str
        The path, or `robot description` for a text.

    Raises
    ------
    ModelError
        If the file cannot be read, is too large or is not UTF-8.
    """
    if isinstance(source, str) and is_text(source):
        return TEXT_NAME, source.lstrip('\ufeff \t\r\n')
    where = os.fspath(source)
    try:
        with Path(where).open('rb') as file:
            raw = file.read(LARGEST_TEXT + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, 'strerror', None) or error
        raise ModelError(where, [f'the file must be readable, got: {reason}']) from error
    try:
        return where, raw.decode('utf-8').lstrip('\ufeff \t\r\n')
    except UnicodeDecodeError as error:
        if len(raw) > LARGEST_TEXT:
            return where, raw.decode('utf-8', 'replace')
        raise ModelError(where, [f'the file must be UTF-8 text, got: {error}']) from error


def complete_text(source: str | os.PathLike[str]) -> str:
    """Return a robot description's text with the files that it names found from everywhere.

    Of a text, itself. Errors are those of :func:`read_source`.
    """
    where, text = read_source(source)
    return text if where == TEXT_NAME else with_absolute_files(text, Path(where).parent)


def with_absolute_files(text: str, folder: Path) -> str:
    """Return a description whose attributes `file` relative to its folder are absolute paths."""

    def absolute(found: re.Match[str]) -> str:
        before, quote, name = found.groups()
        if '://' in name or Path(name).is_absolute():
            return found[0]
        way = escape(f'{folder.resolve()}/', {'"': '&quot;', "'": '&apos;'})
        return f'{before}{quote}{way}{name}'

    return re.sub(
        r"""(<(?:flexible|section)\s[^<>]*?\bfile\s*=\s*)(["'])([^"'<>]+)""", absolute, text
    )


def is_text(source: str) -> bool:
    """Say whether a source is XML text rather than a path."""
    return source.lstrip('\ufeff \t\r\n').startswith('<')


def parse_xml(where: str, text: str, whole: bool = False, root: str = 'robot') -> Element:
    """Return the root element of a description's text.

    Parameters
    ----------
    whole : bool
        Whether comments and processing instructions stay, for a text that is written again.

    Raises
    ------
    ModelError
        For malformed XML, a DOCTYPE or an entity, a text that is too large, another root.
    """
    encoded = text.encode('utf-8', 'surrogatepass')
    if len(encoded) > LARGEST_TEXT:
        rule = f'the text must be at most {LARGEST_TEXT} bytes'
        raise ModelError(where, [f'{rule}, got {len(encoded)} or more'])
    forbidden = re.search(r'<!\s*(DOCTYPE|ENTITY)', text, re.IGNORECASE)
    if forbidden:
        line = text.count('\n', 0, forbidden.start()) + 1
        raise ModelError(
            where, [f'the XML must have no DOCTYPE and no entities, got one, line {line}']
        )
    try:
        found = etree.fromstring(encoded, _parser(whole))
    except etree.XMLSyntaxError as error:
        found = _with_unread_prefixes(encoded, _parser(whole, recover=True))
        if found is None:
            raise ModelError(where, [f'the XML must be well-formed, got: {error.msg}']) from error
    if found.tag != root:
        raise ModelError(where, [f'the root element must be <{root}>, got <{found.tag}>'])
    return found


def _parser(whole: bool, recover: bool = False) -> Any:
    # The encoding is forced: a declared one could hide a DOCTYPE from the search before.
    return etree.XMLParser(
        encoding='utf-8',
        resolve_entities=False,
        no_network=True,
        load_dtd=False,
        huge_tree=False,
        remove_comments=not whole,
        remove_pis=not whole,
        recover=recover,
    )


def _with_unread_prefixes(encoded: bytes, parser: Any) -> Element | None:
    """Return the root of a text whose only fault is prefixes of names that are not read.

    Old files have `<sensor:camera>` without xmlns:sensor inside <gazebo>, and the readers of other
    tools know no namespaces. The names keep their prefix, and are written with it.
    """
    try:
        found = etree.fromstring(encoded, parser)
    except etree.XMLSyntaxError:
        return None
    undeclared = etree.ErrorTypes.NS_ERR_UNDEFINED_NAMESPACE
    if found is None or any(fault.type != undeclared for fault in parser.error_log):
        return None
    read = [each for top in found.iterchildren(*READ_ELEMENTS) for each in top.iter('*')]
    names = [name for each in read for name in (each.tag, *each.attrib)]
    return None if any(':' in name.rpartition('}')[2] for name in names) else found


def written(root: Element, text: str) -> str:
    """Return a changed description as text, with the declaration that it had."""
    declaration = re.match(r'<\?xml.*?\?>\s*', text, re.DOTALL)
    edited = etree.tostring(root.getroottree(), encoding='unicode')
    return f'{declaration[0] if declaration else ""}{edited}\n'
