"""Names out of a stranger's file, as tables and XML can hold them."""

from __future__ import annotations

__all__ = ["table_text", "xml_text"]

import re
from xml.sax.saxutils import escape

_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def table_text(text: str) -> str:
    """``text`` as a cell that no spreadsheet takes for a formula.

    >>> table_text("=HYPERLINK(1)"), table_text("-7"), table_text("cell 3")
    ("'=HYPERLINK(1)", '-7', 'cell 3')
    """
    text = text.encode("utf-8", "replace").decode()
    if not text.startswith(("=", "+", "-", "@", "\t", "\r")):
        return text
    try:
        float(text)
    except ValueError:
        return f"'{text}"
    return text


def xml_text(text: str) -> str:
    """``text`` escaped, with the replacement character for those that XML forbids.

    >>> xml_text("<b>") + xml_text(chr(11))
    '&lt;b&gt;�'
    """
    return escape(_NOT_XML.sub("\ufffd", text))
