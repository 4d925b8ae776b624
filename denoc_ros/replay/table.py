"""Joint states out of a table of numbers, as a bag that `replay_bag` reads."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from denoc_ros.bags.joint_state import FIELDS, JOINT_STATE, JointStateMessage
from denoc_ros.bags.writer import BagWriter
from denoc_ros.errors import BagError
from denoc_ros.identification.channel import Channel, table_times
from denoc_ros.identification.joint_columns import joint_columns
from denoc_ros.identification.tables import read_table
from denoc_ros.types import Array

TOPIC = '/joint_states'


def bag_of_table(
    table: str | Path,
    joints: Sequence[str],
    output: str | Path,
    columns: Mapping[str, str] | None = None,
    times: Channel | None = None,
) -> Path:
    """Write a table's rows as JointState messages on `/joint_states`.

    Parameters
    ----------
    table : str or Path
        A file that `read_table` reads.
    joints : sequence of str
        The robot's. A column `elbow/position`, `elbow.velocity` or `elbow_effort`, also with
        something before it (`/joint_states/elbow/effort`), is that of the joint; `elbow` alone is
        its position [rad, m; per s; N m, N].
    output : str or Path
        The bag, which must not exist yet.
    columns : mapping of str to str, optional
        `joint.field` to the column that it is taken from, whatever the names.
    times : Channel, optional
        Whose `time`, `time_unit` and `rate` say how times are read.

    Returns
    -------
    Path
        Of the bag.

    Raises
    ------
    BagError
        When the table cannot be read, has no times, or no joint's position; or a column does not
        exist.

    Notes
    -----
    A row without one joint's position leaves that joint out; times count from the table's first.
    """
    table, path = Path(table), Path(output)
    given = read_table(table)
    found = joint_columns(table, given, joints, columns or {})
    names = [joint for joint in joints if (joint, 'position') in found]
    if not names:
        raise BagError(
            f'{table}: table must have the position of a joint (columns such as '
            f"'{joints[0]}/position', or named by --column), got {', '.join(list(given)[:20])}"
        )
    rows = max(len(given[found[name, 'position']]) for name in names)
    _, _, t = table_times(table, given, times or Channel(), rows)
    for column in found.values():
        if len(given[column]) != len(t):
            raise BagError(
                f'{table}: {column} must have as many values as there are times ({len(t)}), '
                f'got {len(given[column])}'
            )
    fields = [f for f in FIELDS if any((name, f) in found for name in names)]
    values = np.full((len(t), len(fields), len(names)), np.nan)
    for k, field in enumerate(fields):
        for j, name in enumerate(names):
            if (name, field) in found:
                values[:, k, j] = given[found[name, field]]
    with BagWriter(path) as bag:
        bag.add_topic(TOPIC, JOINT_STATE)
        for stamp_ns, message in _messages(names, fields, t, values):
            bag.write(TOPIC, stamp_ns, message)
    return path


def _messages(
    names: Sequence[str], fields: Sequence[str], t: Array, values: Array
) -> Iterator[tuple[int, bytes]]:
    """Yield stamp [ns] and bytes of each row's message; rows without a position are left out."""
    encoders: dict[tuple[bool, ...], JointStateMessage] = {}
    there = np.isfinite(values[:, fields.index('position')]) & np.isfinite(t)[:, None]
    for row in range(len(t)):
        present = tuple(there[row].tolist())
        if not any(present):
            continue
        if present not in encoders:
            here = [name for name, is_here in zip(names, present, strict=True) if is_here]
            encoders[present] = JointStateMessage(here, fields)
        # a stamp of 0 would say that there is none
        stamp_ns = 1_000_000_000 + round(1e9 * float(t[row]))
        yield stamp_ns, encoders[present].encode(stamp_ns, *values[row][:, there[row]])
