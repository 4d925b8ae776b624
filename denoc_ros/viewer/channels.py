"""Names of the channels of strip charts: `group/name`, a chart for each group."""

from __future__ import annotations

from collections.abc import Mapping

from denoc_ros.model.tree import Tree

SHOWN_COMPONENTS = ('uy', 'uz', 'rx')
NEGLIGIBLE = 1e-3  # of the largest deflection of its kind: neither shown nor judged
ROUNDING = 1e-9  # m or rad: no deflection


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


def shown_deflections(peaks: Mapping[str, float]) -> list[str]:
    """Return the tips' deflections that are not negligible beside others of their kind.

    Parameters
    ----------
    peaks : mapping of str to float
        The largest of each, by name: `link/uy` [m], `link/rx` [rad] and so on.
    """
    parts = {name: name.rpartition('/')[2] for name in peaks}
    largest = {
        kind: max((p for n, p in peaks.items() if parts[n][:1] == kind), default=0.0)
        for kind in ('u', 'r')
    }
    return [
        name
        for name, part in parts.items()
        if part in SHOWN_COMPONENTS and peaks[name] > max(NEGLIGIBLE * largest[part[0]], ROUNDING)
    ]


def torque_channels(tree: Tree) -> Mapping[str, str]:
    """Return the channel of every joint's torque, or force."""
    names = {'N': 'force', 'N m': 'torque'}
    units = {name: joint.effort_unit for name, joint in tree.joints.items()}
    return {name: f'{names[unit]} [{unit}]/{name}' for name, unit in units.items()}


def residual_channel(sensor: str) -> str:
    """Return the channel of a sensor's measured minus predicted value."""
    return f'residual/{sensor}'
