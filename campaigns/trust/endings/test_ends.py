"""Every end has status 0, from every phase of a node's life: the campaign of ends, short."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from trust.endings.ends_campaign import Ends, Tally, ending, phases
from trust.zygote import NODES

pytestmark = [pytest.mark.ros, pytest.mark.alone]
SHORT = [('feedforward', phase) for phase in phases('feedforward')]
SHORT += [(node, 'active') for node in NODES if node != 'feedforward']


@pytest.fixture(scope='module')
def ends(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ends]:
    with ending(tmp_path_factory.mktemp('ends'), seed=3) as ends:
        yield ends


@pytest.mark.parametrize(('node', 'phase'), SHORT)
def test_an_end_has_status_0(ends: Ends, node: str, phase: str) -> None:
    tally = Tally()
    ends.once(node, phase, tally)
    assert tally.ends[phase] == 1
    assert not tally.bad, tally.bad
