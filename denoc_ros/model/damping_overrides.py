"""Damping and friction of a robot, changed without reading its description again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from denoc_ros.model.override_elements import DAMPING
from denoc_ros.model.override_values import critical_damping
from denoc_ros.model.overrides import plain_paths
from denoc_ros.model.tree import Beam, Body, JointKind, Tree
from denoc_ros.types import Array

FIELDS = {'beam': DAMPING, 'joint': ('damping', 'friction')}
# new numbers by element, `joint.shoulder` or `beam.upper_arm.y`, and field
Changes = dict[str, dict[str, Array]]


def with_other_damping(tree: Tree, overrides: Mapping[str, Any]) -> Tree | None:
    """Return a robot with other damping or friction of its beams and joints.

    Parameters
    ----------
    tree : Tree
    overrides : mapping
        By dotted path, as :func:`denoc_ros.model.overrides.with_overrides` takes them.

    Returns
    -------
    Tree or None
        The robot that `with_overrides` returns. None where that has to be asked: for all other
        paths, and for values that it may refuse.
    """
    changes: Changes = {}
    for path, value in overrides.items():
        element, _, field = path.rpartition('.')
        numbers = _numbers(value)
        if numbers is None or field not in FIELDS.get(element.partition('.')[0], ()):
            return None
        changes.setdefault(element, {})[field] = numbers
    known = {element for body in tree.bodies for element in _elements(body)}
    if changes.keys() - known:
        return None
    try:
        bodies = tuple(_changed(body, changes) for body in tree.bodies)
    except ValueError:
        return None
    given = plain_paths({}, {**tree.overrides, **overrides})
    return replace(tree, bodies=bodies, overrides=given)


def _numbers(value: Any) -> Array | None:
    """Return finite numbers >= 0 (k,); None for anything else."""
    parts = np.ravel(np.asarray(value, dtype=object)).tolist()
    if not all(type(part) is float and 0.0 <= part < np.inf for part in parts):
        return None
    return np.array(parts, dtype=np.float64)


def _elements(body: Body) -> list[str]:
    """Elements of a body that can change."""
    joint, beam = body.joint, body.beam
    moves = joint is not None and joint.kind is not JointKind.FIXED
    found = [f'joint.{joint.name}'] if joint is not None and moves else []
    parts = [name for name in ('y', 'z', 'torsion') if getattr(beam, name, None) is not None]
    return found + [f'beam.{body.link}.{name}' for name in parts]


def _changed(body: Body, changes: Changes) -> Body:
    """Body with changed elements; ValueError where a change does not fit."""
    if not changes.keys() & set(_elements(body)):
        return body
    joint, beam = body.joint, body.beam
    if joint is not None and (given := changes.get(f'joint.{joint.name}')):
        # each of one number only
        numbers: dict[str, Any] = {field: each.item() for field, each in given.items()}
        joint = replace(joint, **numbers)
    if beam is not None:
        beam = _changed_beam(beam, f'beam.{body.link}', changes)
    return replace(body, joint=joint, beam=beam)


def _changed_beam(beam: Beam, whose: str, changes: Changes) -> Beam:
    parts: dict[str, Any] = {}
    for name, part, critical in critical_damping(beam):
        for field, numbers in changes.get(f'{whose}.{name}', {}).items():
            many = 1 if field == 'damping_ratio' and beam.segments > 1 else part.modes
            damping = numbers * (critical if field == 'damping_ratio' else np.ones(part.modes))
            if name in parts or len(numbers) not in (1, many) or not np.isfinite(damping).all():
                raise ValueError
            parts[name] = replace(part, damping=damping)
    return replace(beam, **parts)
