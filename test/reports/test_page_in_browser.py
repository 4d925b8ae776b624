"""A page as Chromium shows it: everything in sight at any width, and themes that reach figures."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from browser import chromium
from page_look import VISIBLE, contrast
from playwright.sync_api import Browser
from playwright.sync_api import Page as Tab

from denoc_ros.reports.figures import PHASE_COLOURS, Curve, Panel, line_figure
from denoc_ros.reports.pages import Card, PageSection, PageTable, ReportPage, Verdict

WIDTHS = (360, 420, 768, 1200)  # pixels: phones, a tablet, a desk
LEGIBLE = 8.0  # pixels of type
LONG = 'a_name_without_any_place_to_break_it_as_topics_have_them/and_some_more'

# elements that stick out of the window, and labels of figures that lie on each other
OUTSIDE = """() => [...document.querySelectorAll('main *')].filter(e => !e.closest('svg, .scroll'))
  .filter(e => e.getBoundingClientRect().right > document.documentElement.clientWidth + 1)
  .map(e => e.tagName + ' ' + e.textContent.slice(0, 40))"""
SCROLLED = """() => [...document.querySelectorAll('.scroll')]
  .filter(e => e.scrollWidth > e.clientWidth + 1).length"""
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
        Panel(
            f'panel {k} of {LONG}', 'rad', [Curve('curve', PHASE_COLOURS[0], t, scale * np.sin(t))]
        )
        for k, scale in enumerate((1e-7, 12345.6, 0.3))
    ]
    head = ('name', *(f'column {k}' for k in range(8)))
    table = PageTable(head, [[LONG, *('123.4 mrad' for _ in head[1:])]])
    made = ReportPage(
        f'A page of {LONG}',
        LONG,
        Verdict(f'It comes down to {LONG}.', 'doubtful'),
        [Card(LONG, '15.1 mrad → 4.2 mrad', LONG)] * 5,
        [
            PageSection('Many panels', LONG, [line_figure(panels)], [table]),
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
    # a table of nine columns may be pushed aside on a tablet, on a phone it is a list
    tab.set_viewport_size({'width': WIDTHS[0], 'height': 800})
    assert tab.evaluate(SCROLLED) == 0
    # neither errors nor anything fetched
    assert said == []


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
