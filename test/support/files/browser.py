"""A headless Chromium: the system's, as `make browser` installs it."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager

from playwright.sync_api import Browser, sync_playwright

NAMES = ('chromium', 'chromium-browser', 'google-chrome')
QUIET = (
    '--no-sandbox',
    '--disable-background-networking',
    '--disable-component-update',
    '--disable-sync',
)


@contextmanager
def chromium(*flags: str) -> Iterator[Browser]:
    """Give a browser that is gone afterwards; `flags` are added to its command line."""
    found = next(filter(None, map(shutil.which, NAMES)), None)
    assert found is not None, 'a Chromium must be installed (make browser), got none'
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=found, args=[*QUIET, *flags])
        try:
            yield browser
        finally:
            browser.close()
