"""XML parsed without entities, document types or anything from outside."""

import re
from typing import Any

from pinav.errors import InputError


def parse_xml(content: bytes) -> Any:
    """The root element of a document.

    Raises:
        InputError: it is not well formed, or declares entities or a document type.
    """
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import ParseError, fromstring

    try:
        return fromstring(content, forbid_dtd=True)
    except ParseError as error:
        line, column = error.position
        raise InputError(
            f"line {line}, column {column}: not well-formed XML "
            f"({str(error).partition(':')[0]}); export the tracks again"
        ) from error
    except DefusedXmlException as error:
        raise InputError(
            "the XML declares entities or a document type, which is not read; "
            "export the tracks again"
        ) from error


def root_tag(content: bytes) -> str:
    """Name of the first element, without parsing the rest."""
    match = re.search(rb"<([A-Za-z_][\w.-]*)[\s/>]", content[:5000])
    return match[1].decode() if match else ""


def number(element: Any, name: str, where: str) -> float:
    """A number among the attributes of an element.

    Raises:
        InputError: the attribute is missing or no finite number.
    """
    text = element.get(name)
    try:
        value = float(text) if text is not None and "_" not in text else float("nan")
    except ValueError:
        value = float("nan")
    if value - value != 0:  # neither NaN nor infinite
        got = "nothing" if text is None else repr(text)
        raise InputError(
            f"{where}, attribute {name!r}: expected a finite number, got {got}; "
            "export the tracks again"
        )
    return value
