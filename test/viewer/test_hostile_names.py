"""Names from strangers are shown on a page, and never run: in Chromium, and in pictures."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest
from browser import chromium
from playwright.sync_api import Browser
from playwright.sync_api import Page as Tab

import denoc_ros as dn
from denoc_ros.errors import ConfigError, SolverError
from denoc_ros.pages.figures import Curve, Ink, Panel, line_figure
from denoc_ros.pages.html_page import Card, PageSection, PageTable, ReportPage, Verdict
from denoc_ros.simulation.recorded.snapshot import Snapshot
from denoc_ros.viewer.page import Exhibit, Page, offer
from denoc_ros.viewer.picture import Canvas

TIMEOUT = 90.0  # s; a busy machine draws a picture in seconds
# Elements of HTML, an expression of JSX, a link, an entity, a formula, a control, a direction.
HOSTILE = (
    '<img src="x" onerror="window.owned=1">{window.owned=2}</span><script>window.owned=3</script>'
    '[a](javascript:window.owned=4) &lt;b&gt; $\\frac$ \x1b[31m\u202e'
)
SHOWN = '{window.owned=2}'  # of HOSTILE, as a page must show it


@pytest.fixture(scope='module')
def browser() -> Iterator[Browser]:
    with chromium('--use-angle=swiftshader', '--enable-unsafe-swiftshader') as started:
        yield started


@pytest.fixture
def robot(repository: Path) -> dn.Robot:
    """Return a mechanism whose loop, first joint and own name are hostile."""
    text = (repository / 'config/robots/four_bar_rrf.urdf').read_text()
    name = HOSTILE.partition(' \x1b')[0]
    for old in ('joint_4', 'joint_1', 'four_bar'):
        assert f'"{old}"' in text
        text = text.replace(f'"{old}"', quoteattr(f'{name} {old}'))
    return dn.load_robot(text)


def open_page(browser: Browser, address: str) -> Tab:
    tab = browser.new_page()
    tab.set_default_timeout(1e3 * TIMEOUT)
    tab.goto(address)
    return tab


def require_harmless(tab: Tab) -> None:
    """Assert that nothing of a name has become an element or has been run."""
    assert tab.evaluate('window.owned') is None
    assert tab.locator('img[src="x"]').count() == 0
    assert tab.locator('a[href^="javascript"]').count() == 0


def test_a_page_shows_names_and_errors_and_runs_none(browser: Browser, robot: dn.Robot) -> None:
    def refuse(name: str) -> Exhibit:
        if name == 'first':
            return Exhibit(robot, {})
        raise ConfigError('robot', [HOSTILE])

    def fail(*_given: Any, **_options: Any) -> Any:
        (loop,) = robot.tree.loops
        raise SolverError(f'loop {loop.name} must close')

    with Page(robot) as page:
        offer(page, ('first', 'second'), 'first', refuse)
        sliders: Any = page._panel
        sliders._robot.assemble = fail
        sliders.move()
        tab = open_page(browser, page.address)
        tab.get_by_text('does not close:').wait_for()
        assert SHOWN in tab.get_by_text('does not close:').inner_text()
        # The slider of the joint, too, has its name.
        tab.get_by_text('joint_1 [deg]').first.wait_for()
        tab.get_by_role('textbox', name='Robot').or_(
            tab.locator('input[value="first"]')
        ).first.click()
        tab.get_by_text('second').first.click()
        error = tab.get_by_text(f'robot: {HOSTILE[:10]}').first
        error.wait_for()
        assert SHOWN in error.inner_text()
        assert '\\x1b[31m\\u202e' in error.inner_text()
        require_harmless(tab)
        tab.close()


@pytest.mark.long
def test_charts_show_names_and_run_none(browser: Browser, robot: dn.Robot) -> None:
    channels = {f'{HOSTILE} [m]/{HOSTILE}': 0.5, f'torque [N m]/{HOSTILE}': 1.0}
    moments = [
        Snapshot(t, np.zeros(robot.n), None, {}, {k: v * t for k, v in channels.items()})
        for t in np.linspace(0.0, 1.0, 9)
    ]
    with Page(robot) as page:
        page.play(moments)
        tab = open_page(browser, page.address)
        tab.locator('.uplot').nth(1).wait_for(state='attached')
        assert any(SHOWN in text for text in tab.locator('.uplot').all_inner_texts())
        require_harmless(tab)
        tab.close()


def test_a_report_shows_names_and_runs_none(browser: Browser, tmp_path: Path) -> None:
    t = np.linspace(0.0, 1.0, 20)
    figure = line_figure([Panel(HOSTILE, HOSTILE, [Curve(HOSTILE, Ink.PHASES[0], t, t)])])
    table = PageTable([HOSTILE, HOSTILE], [[HOSTILE, HOSTILE]], folded=True, title=HOSTILE)
    page = ReportPage(
        HOSTILE,
        HOSTILE,
        Verdict(HOSTILE),
        [Card(HOSTILE, HOSTILE, HOSTILE), Card(HOSTILE, rows=[(HOSTILE, HOSTILE)])],
        [PageSection(HOSTILE, HOSTILE, [figure], [table])],
        {HOSTILE: HOSTILE},
    )
    file = tmp_path / 'page.html'
    file.write_text(page.html(), encoding='utf-8')
    assert not {'\x1b', '\u202e'} & set(file.read_text(encoding='utf-8'))
    tab = open_page(browser, file.as_uri())
    assert tab.locator('h1').inner_text().startswith('<img src="x"')
    assert SHOWN in tab.locator('.verdict').inner_text()
    require_harmless(tab)
    tab.close()


@pytest.mark.parametrize('name', ['$\\frac$', '$x^{$', HOSTILE])
def test_a_name_in_a_picture_is_no_formula(name: str) -> None:
    """A name that matplotlib cannot parse ended reports and films with a traceback."""
    canvas = Canvas((320, 240))
    axes = canvas.figure.add_axes((0.2, 0.2, 0.7, 0.6))
    (line,) = axes.plot([0.0, 1.0], label=name)
    axes.set_title(name)
    axes.legend()
    canvas.figure.text(0.1, 0.9, name)
    canvas.animate([line])
    assert canvas.pixels().min() < 255
    t = np.linspace(0.0, 1.0, 20)
    assert line_figure([Panel(name, name, [Curve(name, Ink.PHASES[0], t, t)], x_label=name)])
