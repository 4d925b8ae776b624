"""Cost of a link of segments beside the same link as one beam."""

from __future__ import annotations

from collections.abc import Iterator

from denoc_ros.bench.chains import flexible_chain
from denoc_ros.bench.growth import MODES, STATES
from denoc_ros.bench.pairs import dynamics_lines
from denoc_ros.bench.results import BenchLine
from denoc_ros.bench.rigid import random_states
from denoc_ros.bench.timing import Effort
from denoc_ros.dynamics.robot import Robot, load_robot

SEGMENTS = 8
BEAM = '<beam link="link_1"'


def link_of(segments: int) -> Robot:
    """Return a link on a joint, two modes per plane and segment."""
    text = flexible_chain(1, *MODES)
    return load_robot(text.replace(BEAM, f'{BEAM} segments="{segments}"'))


def segment_lines(effort: Effort) -> Iterator[BenchLine]:
    """Yield inverse and forward dynamics of a link of segments over those of one beam."""
    divided, whole = link_of(SEGMENTS), link_of(1)
    robots = (
        (divided, random_states(divided, count=STATES)),
        (whole, random_states(whole, count=STATES)),
    )
    names = f'a link of {SEGMENTS} segments', 'one beam'
    yield from dynamics_lines('growth', names, robots, float(SEGMENTS), effort)
