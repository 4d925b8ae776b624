"""The tick's latency is measured on a torque that is right."""

from __future__ import annotations

import pytest
from bench.ticks.tick_latency import measure

pytestmark = [pytest.mark.ros, pytest.mark.alone]


def test_tick_is_measured_beside_empty_nodes(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ('ROS_DOMAIN_ID', 'ROS_AUTOMATIC_DISCOVERY_RANGE'):
        monkeypatch.setenv(name, 'set by measure')
    lines = measure(blocks=1, count=20)
    assert [line.check.good for line in lines] == [True, True]
    assert all(line.value is not None and line.value.value > 0.0 for line in lines)
