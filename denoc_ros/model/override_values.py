"""Overrides that keep the coordinates, and the present values of a robot."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from denoc_ros.model import segments
from denoc_ros.model.override_elements import JOINT_FIELDS, SPRING_FIELDS
from denoc_ros.model.overrides import INERTIAL_FIELDS, SENSOR_FIELDS, carrying_links
from denoc_ros.model.tree import Beam, Body, Deformation, Tree

Values = dict[str, float | list[float]]


def override_values(tree: Tree) -> Values:
    """Return the values of a robot by the dotted paths that change them.

    Parameters
    ----------
    tree : Tree
        The robot, without payloads.

    Returns
    -------
    dict of str to float or list of float
        Stiffness and damping ratios of beams, damping, friction and armature of joints, the
        numbers of their springs, gain,
        offset and noise of sensors, and no payload on each link that can carry one.
    """
    values: Values = {}
    for body in tree.bodies:
        values.update(_of_joint(body))
        values.update(_of_beam(body))
        values.update(_of_modes(body))
    for sensor in tree.sensors:
        for field in SENSOR_FIELDS:
            values[f'sensor.{sensor.name}.{field}'] = float(getattr(sensor, field))
    for inertial in tree.inertial_sensors:
        for field in INERTIAL_FIELDS[inertial.type]:
            values[f'sensor.{inertial.name}.{field}'] = float(getattr(inertial, field))
    for link in carrying_links(tree):
        values[f'payload.{link}.mass'] = 0.0
        values[f'payload.{link}.com'] = [0.0] * 3
        values[f'payload.{link}.inertia'] = [0.0] * 6
    return values


def _of_joint(body: Body) -> Iterator[tuple[str, float]]:
    if body.joint is not None:
        for field in JOINT_FIELDS:
            yield f'joint.{body.joint.name}.{field}', float(getattr(body.joint, field))
        if body.joint.spring is not None:
            for field, attribute in SPRING_FIELDS.items():
                value = float(getattr(body.joint.spring, attribute))
                yield f'joint.{body.joint.name}.{field}', value


def critical_damping(beam: Beam) -> Iterator[tuple[str, Deformation, NDArray[np.float64]]]:
    """Yield name (y, z, torsion), deformation and critical damping (modes,) of a beam.

    At a fixed root, of amplitudes scaled as the shape functions are [N s/m or N m s/rad].
    """
    mass, polar = (
        (beam.mass_per_length, beam.mass_along),
        (beam.polar_inertia, beam.polar_along),
    )
    for name, part, inertia in (
        ('y', beam.y, mass),
        ('z', beam.z, mass),
        ('torsion', beam.torsion, polar),
    ):
        if part is not None:
            yield name, part, segments.critical_damping(part, *inertia, beam.segments)


def _of_modes(body: Body) -> Iterator[tuple[str, float | list[float]]]:
    if (modes := body.modes) is not None:
        path = f'flexible.{body.name}'
        yield f'{path}.stiffness', modes.factor
        yield f'{path}.damping', modes.damping.tolist()
        ratio = modes.damping / modes.critical_damping
        yield f'{path}.damping_ratio', [float(f'{r:.12g}') for r in ratio]


def _of_beam(body: Body) -> Iterator[tuple[str, float | list[float]]]:
    if body.beam is None or body.segment > 1:  # all have the numbers of the first
        return
    for name, part, critical in critical_damping(body.beam):
        rigidity = 'gj' if name == 'torsion' else 'ei'
        yield f'beam.{body.name}.{name}.{rigidity}', float(part.stiffness)
        yield f'beam.{body.name}.{name}.damping', part.damping.tolist()
        # rounded: 0.005 in the file is to show as such
        ratio = part.damping / critical
        if body.beam.segments > 1:
            ratio = ratio[:1]
        yield f'beam.{body.name}.{name}.damping_ratio', [float(f'{r:.12g}') for r in ratio]
