"""The look that every page has: whole by itself, readable by all, saying what it is from."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator

from lxml import html

READABLE = 4.5  # WCAG AA: contrast of text
VISIBLE = 3.0  # WCAG AA: contrast of what is drawn
TEXTS = ('ink', 'muted', 'accent', 'good', 'doubtful', 'bad')
DRAWN = ('ink', 'series-1', 'series-2', 'series-3', 'series-4', 'series-5', 'difference')
# a number's unit, `1` for a plain one; a frequency, a time, an amplitude
UNIT = re.compile(r'\[[^\]\s][^\]]*\]')


def require_one_look(page: str, *private: str) -> None:
    """Assert what holds for every page; `private` texts must not be on it."""
    tree = html.fromstring(page)
    _require_alone(page, tree)
    _require_described(tree)
    _require_readable(page)
    names = Counter(tree.xpath('//@id'))
    assert {name for name, count in names.items() if count > 1} == set()
    (verdict,) = tree.xpath('//*[contains(@class, "verdict")]')
    assert verdict.text_content().strip().endswith('.')
    assert {'made', 'versions', 'machine'} <= set(tree.xpath('//footer//dt/text()'))
    for text in private:
        assert text not in page


def _require_alone(page: str, tree: html.HtmlElement) -> None:
    """Nothing is fetched, nothing is run: links lead to the page's own parts only."""
    assert not tree.xpath('//script | //link | //iframe')
    # pictures are in the page itself, on paper of their own in both themes
    sources = tree.xpath('//@src')
    assert [source for source in sources if not source.startswith('data:image/png;base64,')] == []
    assert all(picture.get('alt') for picture in tree.xpath('//img'))
    links = tree.xpath('//@href') + tree.xpath('//@*[name() = "xlink:href"]')
    links += re.findall(r'url\(([^)]*)\)', page)
    assert [link for link in links if not link.startswith('#')] == []
    assert '@import' not in page
    # the names of XML spaces fetch nothing
    assert set(re.findall(r'https?://[\w./]+', page)) <= {
        'http://www.w3.org/2000/svg',
        'http://www.w3.org/1999/xlink',
    }


def _require_described(tree: html.HtmlElement) -> None:
    assert tree.get('lang') == 'en'
    assert tree.findtext('.//title')
    assert len(tree.xpath('//h1')) == 1
    for figure in tree.xpath('//figure'):
        (caption,) = figure.xpath('./figcaption')
        assert caption.text_content()
        (svg,) = figure.xpath('./svg')
        assert svg.get('role') == 'img'
        assert svg.get('aria-label')
        labels = [''.join(g.itertext()).strip() for g in svg.xpath('.//g[@class="axis-label"]')]
        assert len(labels) == 2
        assert [label for label in labels if not UNIT.search(label)] == []
    for table in tree.xpath('//table'):
        widths = {len(row.xpath('./th | ./td')) for row in table.xpath('.//tr')}
        assert len(widths) <= 1


def _require_readable(page: str) -> None:
    colours = dict(_colours(page))
    drawn = re.findall(r'<figure>.*?</figure>', page, re.DOTALL)
    # a colour that does not change with the theme is lost in one of them
    assert not [one for svg in drawn for one in re.findall(r'#[0-9a-f]{6}\b', svg)]
    assert set(re.findall(r'var\(--([\w-]+)\)', ''.join(drawn))) <= set(colours)
    for theme in (0, 1):
        for behind in ('plane', 'surface'):
            back = colours[behind][theme]
            for name in TEXTS:
                assert contrast(colours[name][theme], back) >= READABLE, (name, behind, theme)
        for name in DRAWN:
            assert contrast(colours[name][theme], colours['surface'][theme]) >= VISIBLE, name


def _colours(page: str) -> Iterator[tuple[str, tuple[str, str]]]:
    """Yield the page's variables: name, and its colour in the light and in the dark theme."""
    hexadecimal = r'(#[0-9a-f]{6})'
    for name, light, dark in re.findall(
        rf'--([\w-]+): light-dark\({hexadecimal}, {hexadecimal}\);', page
    ):
        yield name, (light, dark)


def contrast(first: str, second: str) -> float:
    """Return the contrast ratio of two colours, as WCAG 2 defines it."""
    low, high = sorted(map(_luminance, (first, second)))
    return (high + 0.05) / (low + 0.05)


def _luminance(colour: str) -> float:
    parts = [int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5)]
    linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
