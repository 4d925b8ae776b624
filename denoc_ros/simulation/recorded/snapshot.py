"""Snapshot: all data of one instant that a page or a film draws; names of its channels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from denoc_ros.model.tree import Tree
from denoc_ros.types import Array


@dataclass(frozen=True)
class Snapshot:
    """One instant of a robot's motion."""

    t: float  # since the start of the run, or of the session
    # (n,) coordinates in the order of `Robot.coordinate_names`, amplitudes included [rad, m]
    q: Array
    qd: Array | None = None  # (n,) their rates; None: taken as at rest
    torque: Mapping[str, float] | None = None  # [N m] or [N]; None: not known
    # what strip charts plot, by `group/name`: `deflection [m]/predicted link_2 uy`
    channels: Mapping[str, float] = field(default_factory=dict)


def deflection_channel(what: str, tip: str) -> str:
    """Return the channel of a tip's component."""
    link, _, component = tip.rpartition('/')
    group = 'twist [rad]' if component.startswith('r') else 'deflection [m]'
    return f'{group}/{what} {link} {component}'


def torque_channels(tree: Tree) -> Mapping[str, str]:
    """Return the channel of every joint's torque, or force."""
    names = {'N': 'force', 'N m': 'torque'}
    units = {name: joint.effort_unit for name, joint in tree.joints.items()}
    return {name: f'{names[unit]} [{unit}]/{name}' for name, unit in units.items()}


def residual_channel(sensor: str) -> str:
    """Return the channel of a sensor's measured minus predicted value."""
    return f'residual/{sensor}'
