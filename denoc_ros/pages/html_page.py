"""The layout of all HTML pages: verdict, figures of merit, sections, provenance."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

from denoc_ros.terminal_text import visible
from denoc_ros.text_table import aligned
from denoc_ros.units import NONE, PREFIXES, si_prefix

if TYPE_CHECKING:
    from markupsafe import Markup

    from denoc_ros.pages.figures import Figure

Tone = Literal['good', 'doubtful', 'bad']

UNKNOWN = '–'
# a number, and the unit behind it; the exponents and prefixes of this page's texts. `²` counts as
# a letter for `\b`, so the end of a unit is where no letter of a word follows
QUANTITY = re.compile(
    r'(?:± )?[-+−±]?\d[\d.,]*(?:e[-+]?\d+)? '
    r'(?:[pnuµmkMG]?(?:rad|m|s|Hz|N|g|J|W|V|A|Pa|B|strain)(?![A-Za-z])(?:[²³]|\^[23])?'
    r'(?:[·/*² ]*(?:m|s|rad|kg|Hz|K|A|V)(?![A-Za-z])(?:[²³]|\^[23])?)*'
    r'|kg(?![A-Za-z])(?: m²?(?![A-Za-z]))?|°(?:/s|C)?|%|dB\b|min\b|deg\b|MiB\b|GiB\b)'
)


@dataclass(frozen=True)
class PageTable:
    """A table: its heading row, then rows of text."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    folded: bool = False
    title: str = ''  # where it is folded, and in a terminal

    def text(self) -> str:
        """Return it for a terminal."""
        return '\n'.join(filter(None, [self.title, aligned([self.head, *self.rows])]))


@dataclass(frozen=True)
class PageSection:
    """One section of a page."""

    title: str
    text: str
    figures: Sequence[Figure] = ()
    tables: Sequence[PageTable] = ()
    picture: Markup | None = None  # `<img>` elements, whole by themselves


@dataclass(frozen=True)
class Card:
    """A figure of merit on top of a page."""

    label: str
    value: str = ''
    note: str = ''
    # (name, value) In place of one value, those of several phases or motions
    rows: Sequence[tuple[str, str]] = ()


@dataclass(frozen=True)
class Verdict:
    """Conclusion of a page in one sentence."""

    text: str
    tone: Tone = 'good'


@dataclass(frozen=True)
class ReportPage:
    """All that a page shows."""

    # its heading and the line below
    title: str
    subtitle: str
    verdict: Verdict  # what it comes down to
    cards: Sequence[Card]  # figures of merit
    sections: Sequence[PageSection | None]  # in reading order; None is left out
    # what it was made from and with, as `denoc_ros.pages.provenance.provenance` says it
    provenance: Mapping[str, str] = field(default_factory=dict)

    def html(self) -> str:
        """Return it as HTML that needs nothing else, light and dark; texts are escaped."""
        from jinja2 import Environment, PackageLoader

        environment = Environment(
            loader=PackageLoader('denoc_ros.pages', 'templates'),
            autoescape=True,
            finalize=_shown,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        environment.filters['quantities'] = quantities
        return str(environment.get_template('page.html.j2').render(page=self))


def quantities(text: str) -> Markup:
    """Return a text, escaped, whose numbers stay on one line with their units."""
    from markupsafe import Markup, escape

    return Markup(QUANTITY.sub(r'<span class="quantity">\g<0></span>', str(escape(visible(text)))))


def _shown(value: object) -> object:
    """Show the control characters of a text of the page."""
    return visible(value) if type(value) is str else value


def engineering(value: float, unit: str) -> str:
    """Return a number with three digits and an SI prefix, such as `1.23 mrad`."""
    if not math.isfinite(value):
        return UNKNOWN
    size = abs(float(f'{value:.3g}'))  # as shown: 999.7 µs is 1 ms
    # below the last prefix the number stands as it is
    factor, prefix = si_prefix(size) if size >= PREFIXES[-1][0] else NONE
    return f'{value / factor:.3g} {prefix}{unit}'
