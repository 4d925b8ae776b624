"""Names of the channels of strip charts: `group/name`, a chart for each group."""

from __future__ import annotations

from collections.abc import Mapping

from denoc_ros.model.tree import Tree


def deflection_channel(what: str, tip: str) -> str:
    """Return the channel of a tip's component.

    Parameters
    ----------
    what : str
        Whose word it is: `predicted`, `true`, …
    tip : str
        `link/uy` and so on, as the deflection topics name it.
    """
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
