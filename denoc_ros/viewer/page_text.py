"""Texts of a page: names and errors come from files, and a page must show them, not run them.

viser's Markdown makes elements of the HTML in a text: a browser would request the image that a
name has. Texts are HTML here, escaped in one place.
"""

from __future__ import annotations

from html import escape
from typing import Any

from denoc_ros.terminal_text import visible


def boxed(inner: str) -> str:
    """Return a box of the controls around HTML."""
    return f'<div style="padding:0.2em 0.8em 0.5em;font-size:0.8em">{inner}</div>'


class PageText:
    """A text among the controls of a page."""

    def __init__(self, gui: Any) -> None:
        self._handle = gui.add_html('')

    def show(self, text: str) -> None:
        """Show a text, its lines as they are; '' shows nothing."""
        lines = f'<span style="white-space:pre-wrap">{escape(visible(text))}</span>'
        self._handle.content = boxed(lines) if text else ''
