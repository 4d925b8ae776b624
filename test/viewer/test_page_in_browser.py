"""The page as Chromium draws it, by software: pixels, controls, a run; nothing from elsewhere."""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from browser import chromium
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Browser
from playwright.sync_api import Page as Tab

import denoc_ros as dn
from denoc_ros.simulation.recorded.snapshot import Snapshot
from denoc_ros.viewer.page import Page

Pixels = NDArray[np.int16]

WINDOW = {'width': 640, 'height': 360}  # software draws each pixel
TIMEOUT = 90.0  # s; a busy machine draws a picture in seconds
SCENE = slice(0, 300)  # columns left of the controls
RUN = 2.0  # s
AT_REST, PAUSE = 3, 0.25  # pictures that are the same, and the time between them [s]


@pytest.fixture(scope='module')
def browser() -> Iterator[Browser]:
    with chromium('--use-angle=swiftshader', '--enable-unsafe-swiftshader') as started:
        yield started


@pytest.fixture
def page(repository: Path) -> Iterator[Page]:
    """A recorded run of the Canadarm: turning, and bent by up to 5 cm."""
    robot = dn.load_robot(repository / 'config/robots/canadarm.urdf', gravity=(0, 0, 0))
    moments = []
    for t in np.arange(0.0, RUN + 0.125, 0.125):
        q = np.zeros(robot.n)
        q[robot.joint_indices] = 0.8 * t
        q[robot.flexible_indices[::2]] = 0.025 * t
        channels = {'deflection [m]/predicted': 0.025 * t, 'torque [N m]/joint_1': np.sin(t)}
        moments.append(Snapshot(t, q, None, {'joint_1': 5.0}, channels))
    with Page(robot) as page:
        page.play(moments)
        yield page


def pixels(tab: Tab) -> Pixels:
    """Return what is drawn left of the controls."""
    with Image.open(io.BytesIO(tab.screenshot(timeout=1e3 * TIMEOUT))) as image:
        return np.asarray(image.convert('RGB'), dtype=np.int16)[:, SCENE]


def different(one: Pixels, other: Pixels) -> int:
    """Return how many pixels are not nearly the same."""
    return int((np.abs(one - other).max(axis=2) > 24).sum())


def settled(tab: Tab, holds: Callable[[Pixels], bool]) -> Pixels:
    """Return the scene once it has been at rest for a while and holds what it must."""
    until = time.monotonic() + TIMEOUT
    last, same = pixels(tab), 0
    while not (same >= AT_REST and holds(last)):
        assert time.monotonic() < until, 'the scene must change, and come to rest'
        time.sleep(PAUSE)
        now = pixels(tab)
        same = same + 1 if different(now, last) == 0 else 0
        last = now
    return last


def wait_for(holds: Callable[[], bool]) -> None:
    """Return once the page knows what was typed: its first digits come before the rest."""
    until = time.monotonic() + TIMEOUT
    while not holds():
        assert time.monotonic() < until
        time.sleep(0.02)


def set_number(tab: Tab, label: str, value: float) -> None:
    """Type a number beside a slider."""
    place = f'xpath=//label[normalize-space(.)="{label}"]/following::input[not(@type="hidden")][1]'
    tab.locator(place).fill(str(value))
    tab.locator(place).press('Enter')


@pytest.mark.long
def test_page_draws_bends_and_scrubs(browser: Browser, page: Page) -> None:
    tab = browser.new_page(viewport=WINDOW)  # type: ignore[arg-type]
    problems: list[str] = []
    requests: list[str] = []
    tab.on('pageerror', lambda error: problems.append(str(error)))
    tab.on('console', lambda m: problems.append(m.text) if m.type == 'error' else None)
    tab.on('request', lambda request: requests.append(request.url))
    tab.goto(page.address)
    tab.get_by_text('Colour by strain').wait_for()
    warning = tab.get_by_text('Software WebGL').locator('xpath=ancestor::*[@role="alert"]//button')
    warning.dispatch_event('click')  # it slides in for as long as a busy machine draws
    # the robot is neither the background nor the ground's lines, which are grey
    start = settled(tab, lambda p: (np.ptp(p, axis=2) > 12).sum() > 100)

    set_number(tab, 'Time [s]', 1.5)
    wait_for(lambda: page._moment.t == 1.5)
    turned = settled(tab, lambda p: different(p, start) > 400)

    set_number(tab, 'Scale', 100)
    wait_for(lambda: page._controls.look.scale == 100.0)
    # 550 here; the browser's own change of resolution, when it is slow, makes 260
    settled(tab, lambda p: different(p, turned) > 400)

    tab.get_by_text('Undeflected ghost').locator('xpath=following::input[1]').wait_for(
        state='attached'
    )
    assert tab.locator('.uplot').count() == 2
    assert not problems
    # the page itself and what it holds; nothing from a network
    assert all(url.startswith((page.address, 'data:', 'blob:')) for url in requests), requests
    tab.close()
