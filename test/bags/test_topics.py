"""Topics are found by the end of their names."""

from __future__ import annotations

import pytest

from denoc_ros.bags.series import find_topic


@pytest.mark.parametrize(
    ('topics', 'found'),
    [
        (['/b/effort', '/a/effort'], '/a/effort'),
        (['/a/effort', '/effort'], '/effort'),
        (['/noeffort', '/a/effort/raw'], ''),
        ([], ''),
    ],
)
def test_the_whole_name_goes_before_an_ending(topics: list[str], found: str) -> None:
    assert find_topic(topics, 'effort') == found
