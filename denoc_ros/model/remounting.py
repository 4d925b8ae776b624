"""A description with one IMU or accelerometer turned on its link."""

from __future__ import annotations

import os

from denoc_ros.errors import ConfigError
from denoc_ros.model.findings import Element
from denoc_ros.model.inertial_sensors import OWN
from denoc_ros.model.poses import number_text, rotation_rpy, rpy_of
from denoc_ros.model.source import parse_xml, read_source, written
from denoc_ros.model.urdf import tree_of
from denoc_ros.types import Array


def remounted_description(source: str | os.PathLike[str], sensor: str, rotation: Array) -> str:
    """Return a description's text with a sensor's `rpy` turned, the rest as it was.

    Parameters
    ----------
    source : str or path
        A file's path or XML text.
    sensor : str
        Name of an IMU or accelerometer.
    rotation : (3, 3) array
        Its true axes, seen from those that the description says.

    Raises
    ------
    ConfigError, ModelError
        The description has no such sensor, or is no robot.
    """
    where, text = read_source(source)
    root = parse_xml(where, text, whole=True)
    for element in root.findall('flexibility/sensor'):
        if element.get('name') == sensor and element.get('type') in OWN:
            said = rotation_rpy(_numbers(element))
            element.set('rpy', number_text(*rpy_of(said @ rotation)))
            edited = written(root, text)
            tree_of(parse_xml(where, edited), where, edited)
            return edited
    raise ConfigError(where, [f'sensor {sensor!r} must be an IMU or accelerometer, got none'])


def _numbers(element: Element) -> Array:
    import numpy as np

    return np.array([float(number) for number in element.get('rpy', '0 0 0').split()])
