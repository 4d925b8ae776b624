"""Who may talk to a page, and what it takes from them."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from contextlib import closing
from importlib.metadata import version
from typing import Any

import numpy as np
import pytest
from node_robots import two_links
from viewer_client import ViewerClient
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin, Subprotocol

import denoc_ros as dn
from denoc_ros.simulation.recorded.snapshot import Snapshot
from denoc_ros.viewer.page import Page, is_welcome


@pytest.fixture
def page() -> Iterator[Page]:
    with Page(dn.load_robot(two_links()), origins=['lab.example']) as page:
        yield page


@pytest.mark.parametrize(
    ('origin', 'host', 'welcome'),
    [
        (None, 'localhost:8080', True),
        ('http://localhost:8080', 'localhost:8080', True),
        ('http://127.0.0.1:9000', '127.0.0.1:8080', True),
        ('http://[::1]:8080', '[::1]:8080', True),
        ('http://10.0.0.5:8080', '10.0.0.5:8080', True),
        ('https://lab.example', '10.0.0.5:8080', True),
        ('http://evil.example', 'localhost:8080', False),
        ('http://evil.example:8080', 'evil.example:8080', False),
        ('http://10.0.0.6:8080', '10.0.0.5:8080', False),
        ('null', 'localhost:8080', False),
        ('http://[', 'localhost:8080', False),
        ('', '', False),
    ],
)
def test_only_the_own_page_is_welcome(origin: str | None, host: str, welcome: bool) -> None:
    assert is_welcome(origin, host, ['lab.example']) == welcome


def test_this_machine_is_welcome_by_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, 'gethostname', lambda: 'Robot')
    for name in ('robot', 'robot.local'):  # .local: as zeroconf has it
        assert is_welcome(f'http://{name}:8080', f'{name}:8080', [])
    assert not is_welcome('http://other.local:8080', 'other.local:8080', [])


def test_a_page_of_another_host_is_refused(page: Page) -> None:
    address = page.address.replace('http', 'ws', 1)
    with pytest.raises(InvalidStatus) as refused:
        connect(address, origin=Origin('http://evil.example'), proxy=None)
    assert refused.value.response.status_code == 403
    protocol = Subprotocol(f'viser-v{version("viser")}')
    for name in ('http://localhost:1', 'http://lab.example'):
        connect(address, origin=Origin(name), subprotocols=[protocol], proxy=None).close()


def controls(page: Page) -> dict[str, Any]:
    return {
        handle.label: handle for handle in page.server.gui._gui_input_handle_from_uuid.values()
    }


@pytest.mark.parametrize('bad', [float('nan'), float('inf'), -3.0, 1e300, 'two', None, [], True])
def test_a_scale_that_is_none_changes_nothing(page: Page, bad: Any) -> None:
    scale = controls(page)['Scale']
    with (
        closing(ViewerClient(page.address)) as client,
        closing(ViewerClient(page.address)) as other,
    ):
        for updates in ({'value': bad}, {'update_cb': 3}, {'value': 5.0, 'removed': True}):
            client.send({'type': 'GuiUpdateMessage', 'uuid': scale._impl.uuid, 'updates': updates})
        client.send(
            {'type': 'GuiUpdateMessage', 'uuid': scale._impl.uuid, 'updates': {'value': 7.0}}
        )
        end = time.monotonic() + 90.0
        while scale.value != 7.0:
            assert time.monotonic() < end
            client.receive(0.05)
        page.show(Snapshot(0.0, np.zeros(page._view.robot.n)))
        assert other.receive(10.0)
    assert np.isfinite(scale.value)
