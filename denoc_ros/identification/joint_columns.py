"""Which column of a table, or name in a bag, is which joint's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from denoc_ros.bags.joint_state import FIELDS
from denoc_ros.errors import BagError
from denoc_ros.types import Array

SEPARATORS = './_ '  # between a joint's name and what of it a column holds


def joint_columns(
    table: Path,
    given: Mapping[str, Array],
    joints: Sequence[str],
    named: Mapping[str, str],
    fields: Sequence[str] = FIELDS,
) -> dict[tuple[str, str], str]:
    """Return the column of each joint and field that a table has.

    Parameters
    ----------
    table : Path
        What messages call it.
    given : mapping of str to array
        Its columns.
    joints : sequence of str
        The robot's.
    named : mapping of str to str
        `joint.field` to the column that it is taken from, whatever the names.
    fields : sequence of str
        Of a joint; default: position, velocity and effort.

    Raises
    ------
    BagError
        Two columns of a name, or a named one that does not exist.
    """
    found: dict[tuple[str, str], str] = {}
    for joint in joints:
        for field in fields:
            endings = [f'{joint}{separator}{field}' for separator in SEPARATORS]
            matches = [c for c in given if any(_ends(c, ending) for ending in endings)]
            if field == 'position' and not matches:
                matches = [column for column in given if column == joint]
            if len(matches) > 1 and f'{joint}.{field}' not in named:
                raise BagError(
                    f'{table}: {field} of {joint} must be in one column, '
                    f'got {", ".join(matches)}: --column {joint}.{field}=COLUMN'
                )
            if matches:
                found[joint, field] = matches[0]
    for what, column in named.items():
        joint, _, field = what.rpartition('.')
        if joint not in joints or field not in fields:
            raise BagError(
                f'{table}: --column must name JOINT.{"|".join(fields)} of the robot '
                f'({", ".join(joints)}), got {what!r}'
            )
        if column not in given:
            raise BagError(
                f'{table}: --column {what} must be one of {", ".join(list(given)[:20])}, '
                f'got {column!r}'
            )
        found[joint, field] = column
    return found


def joints_with(given: Mapping[str, Array], fields: Sequence[str]) -> list[str]:
    """Return the joints that have a column of each of these fields."""
    found: dict[str, set[str]] = {}
    for column in given:
        for field in fields:
            for separator in SEPARATORS:
                if column.endswith(f'{separator}{field}'):
                    joint = column.removesuffix(f'{separator}{field}')
                    found.setdefault(joint, set()).add(field)
    return [joint for joint, has in found.items() if joint and len(has) == len(fields)]


def _ends(column: str, ending: str) -> bool:
    """Say whether a column's name is an ending, or has it behind a separator."""
    return column == ending or any(column.endswith(f'{s}{ending}') for s in './')


def renamed(names: tuple[str, ...], rename: Mapping[str, str]) -> dict[str, str]:
    """Map the robot's names to those in the bag."""
    found = {}
    for name in names:
        start = max((s for s in rename if name.startswith(s)), key=len, default='')
        found[rename.get(start, '') + name[len(start) :]] = name
    return found
