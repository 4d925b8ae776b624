"""Settings of the tracking of parameters."""

from __future__ import annotations

from dataclasses import dataclass

from denoc_ros.settings import require_declared, setting


@dataclass(frozen=True)
class TrackerSettings:
    """How parameters are tracked.

    Raises
    ------
    StateError
        If a value is out of range.
    """

    step: float = setting(
        0.005,
        'time over which joint states are drawn together; longer where they come less often',
        's',
        positive=True,
        finite=True,
    )
    block: float = setting(
        0.05,
        'time over which measured and predicted values are compared as means',
        's',
        positive=True,
        finite=True,
    )
    memory: float = setting(
        0.5,
        'time of motion after which data count less by a factor e: longer is steadier, '
        'shorter follows faster',
        's',
        positive=True,
        finite=True,
    )
    rate: float = setting(
        1.0,
        'largest change of a number of `adapt` in a second, as a share of the width of its bounds',
        '1/s',
        positive=True,
        finite=True,
    )
    model_error: float = setting(
        0.01,
        'assumed error of the rest of the model, as a share of its torques: what it explains '
        'moves no number of `adapt`',
        positive=True,
        finite=True,
    )
    cutoff: float = setting(
        10.0,
        'bandwidth of the filter that gives rates where joint states have none',
        'Hz',
        positive=True,
        finite=True,
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
