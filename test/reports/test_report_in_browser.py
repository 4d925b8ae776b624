"""A page as Chromium shows it: everything in sight at any width, and themes that reach figures."""

from __future__ import annotations

import base64
from collections.abc import Iterator

import numpy as np
import pytest
from browser import chromium
from markupsafe import Markup
from page_look import VISIBLE, contrast
from playwright.sync_api import Browser
from playwright.sync_api import Page as Tab

from denoc_ros.pages.figures import Curve, Ink, Panel, histogram_figure, line_figure
from denoc_ros.pages.html_page import Card, PageSection, PageTable, ReportPage, Verdict
from denoc_ros.pages.loop_timing import LoopMeasure

WIDTHS = (360, 390, 420, 768, 1280)  # pixels: phones, a tablet, a desk
LEGIBLE = 8.0  # pixels of type
LONG = 'a_name_without_any_place_to_break_it_as_topics_have_them/and_some_more'

# elements that stick out of the window, and labels of figures that lie on each other
OUTSIDE = """() => [...document.querySelectorAll('main *')].filter(e => !e.closest('svg, .scroll'))
  .filter(e => e.getBoundingClientRect().right > document.documentElement.clientWidth + 1)
  .map(e => e.tagName + ' ' + e.textContent.slice(0, 40))"""
# the page itself must not be pushed aside, nor anything on it but a table in its own box
PUSHED = """() => [...document.querySelectorAll('html, body, section, .pictures, .panels, .cards')]
  .filter(e => e.scrollWidth > e.clientWidth + 1).map(e => e.tagName + ' ' + e.className)"""
# numbers that stand on another line than their units, and tables that are none any more
PARTED = """() => [...document.querySelectorAll('.quantity')]
  .filter(e => e.getClientRects().length !== 1).map(e => e.textContent)"""
TABLES = """() => [...document.querySelectorAll('table')].every(table =>
  getComputedStyle(table).display === 'table' && [...table.rows].every(row =>
    new Set([...row.cells].map(c => Math.round(c.getBoundingClientRect().top))).size === 1))"""
# of each table, how far the first column leaves its box when the rest is pushed aside
FIRST = """() => [...document.querySelectorAll('.scroll')].map(box => {
  box.scrollLeft = 1e4;
  const cell = box.querySelector('tbody th').getBoundingClientRect();
  const left = box.getBoundingClientRect().left;
  box.scrollLeft = 0;
  return cell.left - left;
})"""
OVERLAPS = """() => [...document.querySelectorAll('figure svg')].flatMap(svg => {
  const boxes = [...svg.querySelectorAll('text')]
    .map(t => [t.textContent, t.getBoundingClientRect()]);
  return boxes.flatMap(([name, a], k) => boxes.slice(k + 1).filter(([_, b]) =>
    a.left < b.right - 1 && b.left < a.right - 1 && a.top < b.bottom - 3 && b.top < a.bottom - 3
  ).map(([other, _]) => name.trim() + ' on ' + other.trim()));
})"""
SMALLEST = """() => Math.min(...[...document.querySelectorAll('figure svg text')]
  .map(t => [parseFloat(getComputedStyle(t).fontSize), t.getScreenCTM()])
  .map(([size, to]) => size * Math.hypot(to.a, to.b)))"""
COLOUR = """([selector, what]) => {
  const [r, g, b] = getComputedStyle(document.querySelector(selector))[what].match(/\\d+/g);
  return '#' + [r, g, b].map(v => Number(v).toString(16).padStart(2, '0')).join('');
}"""


@pytest.fixture(scope='module')
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    t = np.linspace(0.0, 17.5, 400)
    panels = [
        Panel(f'panel {k} of {LONG}', 'rad', [Curve('curve', Ink.PHASES[0], t, scale * np.sin(t))])
        for k, scale in enumerate((1e-7, 12345.6, 0.3))
    ]
    head = ('name', *(f'column {k}' for k in range(8)))
    table = PageTable(head, [[LONG, *('123.4 mrad' for _ in head[1:])]])
    small = PageTable(
        ('joint', 'torque', 'share'), [['j1', '12.5 N m', '−3.4 %'], [LONG, '1 s', '']]
    )
    png = base64.b64encode(b'\x89PNG\r\n\x1a\n').decode()
    pictures = Markup('').join(
        Markup(
            '<img alt="moment" width="460" height="360" src="data:image/png;base64,{}">'
        ).format(png)
        for _ in range(6)
    )
    loops = [
        LoopMeasure(
            'plant', 1e-3, 1e-3, 1.2e-3, 9e-3, np.arange(0.0, 3.1, 0.1),
            np.concatenate([np.full(20, 40.0), np.zeros(10), [beyond]]), 1240, 40, 0,
        )
        for beyond in (0.0, 40.0)
    ]  # fmt: skip
    made = ReportPage(
        f'A page of {LONG}',
        LONG,
        Verdict(f'It comes down to {LONG}.', 'doubtful'),
        [
            *[Card(LONG, '15.1 mrad', LONG)] * 3,
            *[Card('error', rows=[(LONG, '15.1 mrad'), ('second', '4.2 mrad')])] * 2,
        ],
        [
            PageSection(
                'Many panels', f'{LONG} of 12.3 mm', [line_figure(panels)], [table, small]
            ),
            PageSection('Loops', '', [histogram_figure(loops)], picture=pictures),
            PageSection(
                'One', '', [line_figure(panels[:1])], [PageTable(('', ''), [['key', LONG]])]
            ),
        ],
        {'bag': '0123456789abcdef' * 4},
    )
    file = tmp_path_factory.mktemp('page') / 'page.html'
    file.write_text(made.html(), encoding='utf-8')
    return file.as_uri()


@pytest.fixture(scope='module')
def browser() -> Iterator[Browser]:
    with chromium('--disable-gpu') as started:
        yield started


def colour(tab: Tab, selector: str, what: str) -> str:
    return str(tab.evaluate(COLOUR, [selector, what]))


def test_nothing_is_cut_at_any_width(browser: Browser, page: str) -> None:
    tab = browser.new_page()
    said: list[str] = []
    tab.on('console', lambda message: said.append(message.text))
    tab.on('request', lambda request: said.append(request.url) if request.url != page else None)
    tab.goto(page)
    for width in WIDTHS:
        tab.set_viewport_size({'width': width, 'height': 800})
        assert tab.evaluate(OUTSIDE) == [], width
        assert tab.evaluate(OVERLAPS) == [], width
        assert tab.evaluate(SMALLEST) >= LEGIBLE, width
        assert tab.evaluate(PUSHED) == [], width
        assert tab.evaluate(PARTED) == [], width
        assert tab.evaluate(TABLES), width
    # neither errors nor anything fetched
    assert said == []


def test_a_wide_table_keeps_its_first_column_in_sight(browser: Browser, page: str) -> None:
    """On a phone tables fell into lists, and a row was no longer comparable with the next."""
    tab = browser.new_page(viewport={'width': 390, 'height': 800})
    tab.goto(page)
    assert np.all(np.abs(tab.evaluate(FIRST)) <= 1.0)
    assert tab.locator('.quantity').count() > 10


def test_a_value_on_a_card_has_its_own_look_beside_its_name(browser: Browser, page: str) -> None:
    """A number with its unit had the look of the label, and each stood on a line of its own."""
    for width in (390, 1280):
        tab = browser.new_page(viewport={'width': width, 'height': 800})
        tab.goto(page)
        for value in tab.locator('.card b .quantity, .card dd .quantity').all():
            assert value.evaluate('box => getComputedStyle(box).display') == 'inline'
        assert colour(tab, '.card b .quantity', 'color') == colour(tab, '.card b', 'color')
        name = tab.locator('.card dt').first.bounding_box()
        number = tab.locator('.card dd').first.bounding_box()
        assert name is not None
        assert number is not None
        assert number['x'] >= name['x'] + name['width']
        assert abs(number['y'] - name['y']) < 8.0


def test_what_a_histogram_does_not_show_has_a_bar(browser: Browser, page: str) -> None:
    """Its overflow stood in the axis' label only."""
    for width in (390, 1280):
        tab = browser.new_page(viewport={'width': width, 'height': 800})
        tab.goto(page)
        bars = tab.locator('figure .overflow path')
        assert bars.count() == 1
        box = bars.first.bounding_box()
        assert box is not None
        assert box['width'] > 4.0
        assert box['height'] > 10.0
        assert 'longer' in tab.locator('figure:has(.overflow) svg').inner_html()


@pytest.mark.parametrize('system', ['light', 'dark'])
def test_themes_reach_the_figures(browser: Browser, page: str, system: str) -> None:
    tab = browser.new_page(color_scheme=system)
    tab.goto(page)
    behind = {}
    for theme in ('auto', 'light', 'dark'):
        tab.check(f'#{theme}', force=True)
        behind[theme] = colour(tab, 'section', 'backgroundColor')
        for label, what in (('.axis-label text', 'fill'), ('svg path[clip-path]', 'stroke')):
            assert contrast(colour(tab, f'figure {label}', what), behind[theme]) > 1.0
        assert contrast(colour(tab, 'figure .axis-label text', 'fill'), behind[theme]) > VISIBLE
    assert behind['auto'] == behind[system]
    assert behind['light'] != behind['dark']
    # paper is white
    tab.emulate_media(media='print')
    assert colour(tab, 'section', 'backgroundColor') == behind['light']
