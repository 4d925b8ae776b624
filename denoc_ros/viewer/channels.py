"""Names of the channels of strip charts: `group/name`, a chart for each group."""

from __future__ import annotations

from collections.abc import Mapping

from denoc_ros.model.tree import JointKind, Tree


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
    return {
        body.joint.name: (
            f'force [N]/{body.joint.name}'
            if body.joint.kind is JointKind.PRISMATIC
            else f'torque [N m]/{body.joint.name}'
        )
        for body in tree.bodies
        if body.joint is not None
    }


def residual_channel(sensor: str) -> str:
    """Return the channel of a sensor's measured minus predicted value."""
    return f'residual/{sensor}'
