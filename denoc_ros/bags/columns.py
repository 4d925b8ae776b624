"""Joint states of one topic in bulk, as arrays."""

from __future__ import annotations

import numpy as np

from denoc_ros.bags.cdr import CdrError, CdrReader
from denoc_ros.bags.joint_series import JointSeries
from denoc_ros.bags.joint_state import FIELDS, JOINT_STATE, JointStateLayout
from denoc_ros.errors import BagError


class JointStateColumns:
    """Collects the raw messages of one topic; `series` makes arrays of them.

    Parameters
    ----------
    topic : str
        Named in errors.
    """

    def __init__(self, topic: str) -> None:
        self.topic = topic
        self._layout: JointStateLayout | None = None
        self._stamps: list[int] = []
        self._parts: list[tuple[JointStateLayout, int, tuple[bytearray, ...]]] = []

    def append(self, raw: bytes, log_ns: int) -> None:
        """Take in one message's CDR bytes; a zero stamp counts as its log time [ns].

        Raises
        ------
        BagError
            When they are no JointState.
        """
        layout = self._layout
        if layout is None or not layout.fits(raw):
            layout = self._layout = self._learn(raw)
            self._parts.append((layout, len(self._stamps), tuple(bytearray() for _ in FIELDS)))
        self._stamps.append(layout.stamp_ns(raw) or log_ns)
        for store, (start, count) in zip(self._parts[-1][2], layout.blocks, strict=True):
            store += raw[start : start + 8 * count]

    def series(self) -> JointSeries:
        """Return all messages as arrays; NaN where a message does not have a joint or field."""
        names = tuple(dict.fromkeys(name for part in self._parts for name in part[0].names))
        stamps = np.array(self._stamps, dtype=np.int64)
        fields = {field: np.full((len(stamps), len(names)), np.nan) for field in FIELDS}
        for layout, first, stores in self._parts:
            columns = [names.index(name) for name in layout.names]
            for field, store, (_, count) in zip(FIELDS, stores, layout.blocks, strict=True):
                if count:
                    rows = np.frombuffer(store, dtype=f'{layout.order}f8').reshape(-1, count)
                    fields[field][first : first + len(rows), columns] = rows
        return JointSeries(stamps, names, **fields)

    def _learn(self, raw: bytes) -> JointStateLayout:
        try:
            layout = JointStateLayout.of(CdrReader(raw))
        except CdrError as error:
            raise BagError(
                f'{self.topic}: message must be a whole {JOINT_STATE}, got {len(raw)} bytes'
            ) from error
        if wrong := layout.wrong_length():
            field, count = wrong
            raise BagError(
                f'{self.topic}: {field} must have as many values as name has '
                f'({len(layout.names)}) or none, got {count}'
            )
        return layout
