"""Settings of the tracking of parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from denoc_ros.dynamics.parameter_columns import live_paths
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ConfigError
from denoc_ros.model.numbers import match, own_path, some_of
from denoc_ros.settings import documented, positive, require_declared, setting
from denoc_ros.types import Array


@documented
@dataclass(frozen=True)
class TrackerSettings:
    """How parameters are tracked.

    Raises
    ------
    StateError
        If a value is out of range.
    """

    step: float = positive(
        0.005,
        'time over which joint states are drawn together; longer where they come less often',
        's',
    )
    block: float = positive(
        0.05, 'time over which measured and predicted values are compared as means', 's'
    )
    memory: float = positive(
        0.5,
        'time of motion after which data count less by a factor e: longer is steadier, '
        'shorter follows faster',
        's',
    )
    rate: float = positive(
        1.0,
        'largest change of a number of `adapt` in a second, as a share of the width of its bounds',
        '1/s',
    )
    model_error: float = positive(
        0.01,
        'assumed error of the rest of the model, as a share of its torques: what it explains '
        'moves no number of `adapt`',
    )
    cutoff: float = positive(
        10.0, 'bandwidth of the filter that gives rates where joint states have none', 'Hz'
    )
    lag: float = setting(
        0.05,
        "delay with which sensors' values may come: the tracking is so far behind",
        's',
        0.0,
        finite=True,
    )

    def __post_init__(self) -> None:
        require_declared(self, 'tracker')


# Which numbers of a robot are tracked, and within which bounds ----------------------------------

WHERE = 'adapt'
SHARE = 0.5  # of a value, by which it may change where no bounds are given


def tracked_paths(robot: Robot, patterns: Sequence[str]) -> tuple[str, ...]:
    """Return the paths of a robot that patterns match, each once.

    Raises
    ------
    ConfigError
        A pattern of nothing that can be tracked, no pattern at all, or a robot with loops or a
        base that floats.
    """
    findings = [] if patterns else ['paths must name what is tracked, got none']
    if robot.tree.loops:
        names = ', '.join(loop.name for loop in robot.tree.loops)
        findings.append(f'the robot must have no loops, got {names}')
    if len(robot.base_indices):
        findings.append('the base must be fixed or its motion measured, got one that floats')
    known = live_paths(robot)
    chosen: dict[str, None] = {}
    for pattern in patterns:
        plain = own_path(pattern, known)
        found = match(known, plain, *[f'{plain}.mass'] * plain.startswith('payload.'))
        if not found:
            shown = some_of(known, pattern, known)
            findings.append(f'{pattern!r} must be of one of {shown}; got none')
        chosen.update(dict.fromkeys(found))
    ConfigError.raise_any(WHERE, findings)
    return tuple(chosen)


def tracked_bounds(
    paths: Sequence[str], start: Array, given: Mapping[str, tuple[float, float]]
) -> Array:
    """Return the lowest and highest values (p, 2) of paths that are at start (p,) now.

    Raises
    ------
    ConfigError
        Bounds of another path, in the wrong order, negative, or without the present value; a
        value that is 0 and has none.
    """
    findings = [
        f'bounds must be of {", ".join(paths)}, got {key!r}' for key in given if key not in paths
    ]
    found = np.empty((len(paths), 2))
    for k, (path, value) in enumerate(zip(paths, start.tolist(), strict=True)):
        low, high = given.get(path, ((1.0 - SHARE) * value, (1.0 + SHARE) * value))
        found[k] = low, high
        if not (math.isfinite(low) and math.isfinite(high) and 0.0 <= low < high):
            way = '' if path in given else ' (it is 0: give its bounds)'
            findings.append(
                f'bounds of {path!r} must be 0 <= low < high, got {low:g} and {high:g}{way}'
            )
        elif not low <= value <= high:
            findings.append(
                f'bounds of {path!r} must have its value {value:g} within, '
                f'got {low:g} and {high:g}'
            )
    ConfigError.raise_any(WHERE, findings)
    return found
