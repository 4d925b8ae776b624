"""Values of sensors that state feedback reads: of beams and, behind them, of gyroscopes."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from denoc_ros.model.sensors import SensorValue, inertial_values
from denoc_ros.model.tree import Tree


def numbered_values(tree: Tree) -> list[SensorValue]:
    """Return the values of all sensors, those on beams first: so nodes number them.

    Sensors on beams have no bias.
    """
    beams = zip(tree.sensors, tree.beam_sensor_places, strict=True)
    of_beams = [SensorValue(s.name, row, s.noise, 0.0, s.topic, 'beam') for s, row in beams]
    return [*of_beams, *inertial_values(tree)]


def read_sensors(tree: Tree) -> NDArray[np.intp]:
    """Return which of :func:`numbered_values` feedback reads.

    Those with a topic and noise; of IMUs the angular rates. A specific force tells what torque
    does at once, and so mostly how wrong the model is.
    """
    found = [
        place
        for place, value in enumerate(numbered_values(tree))
        if value.topic and value.noise > 0.0 and value.kind != 'accel'
    ]
    return np.array(found, dtype=np.intp)


def unread_values(tree: Tree) -> list[str]:
    """Return the names of the values that feedback does not read."""
    read = set(read_sensors(tree).tolist())
    return [v.name for place, v in enumerate(numbered_values(tree)) if place not in read]


def chosen_values(tree: Tree, places: Iterable[int]) -> list[SensorValue]:
    """Return the values at places among :func:`numbered_values`."""
    values = numbered_values(tree)
    return [values[place] for place in places]
