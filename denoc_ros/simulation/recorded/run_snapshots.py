"""A recorded run as snapshots, for scrubbing and films."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import overload

import numpy as np

from denoc_ros.bags.run import RecordedTopics, read_run
from denoc_ros.bags.series import JointSeries, Series
from denoc_ros.dynamics.driven.driven_motion import driven_motion
from denoc_ros.dynamics.driven.measured_side import described_coordinates
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import BagError, ConfigError
from denoc_ros.estimation.turns import without_turns
from denoc_ros.simulation.recorded.snapshot import (
    Snapshot,
    deflection_channel,
    residual_channel,
    torque_channels,
)
from denoc_ros.types import Array
from denoc_ros.units import deflection_unit

INSIDE = 1e-6  # share of the phases by which the last moment is before their end

# Where all coordinates come from: the first that the bag has. Joints alone leave links straight.
STATES = {
    'plant': 'plant/true_modal_state',
    'predictor': 'predictor/modal_state',
    'replay': 'replay/modal_state',
    'joints': 'joint_states',
}
# Topics of torque: the first with values.
TORQUES = ('joint_states', 'feedforward/effort', 'replay/flexible/effort', 'replay/rigid/effort')
DEFLECTIONS = {
    'predictor/tip_deflection': 'predicted',
    'replay/tip_deflection': 'replayed',
    'plant/true_deflection': 'true',
}
RESIDUAL = 'predictor/sensor_residual'
SHOWN_COMPONENTS = ('uy', 'uz', 'rx')
NEGLIGIBLE = 1e-3  # of the largest deflection of its unit: neither shown nor judged
RATE = 60.0  # Hz, of the moments kept


class RecordedRun(Sequence[Snapshot]):
    """The moments of a recorded run, thinned while they are read.

    Parameters
    ----------
    path : Path
        A bag: of `denoc up`, of the recorder, of `denoc simulate` or of `denoc replay`.
    robot : Robot
        Whose coordinates they are, by name; its workspace is used.
    source : {'', 'plant', 'predictor', 'replay', 'joints'}
        Where the amplitudes come from; '': the first of these that the bag has. `joints` are
        the joint states alone: links are straight.
    start, end : float
        What is taken of the run [s since its origin].
    rate : float
        Moments per second at most; fewer where the run is so long that they would be more than
        `bags.run.MOST_ROWS`.

    Attributes
    ----------
    source : str
        Where the amplitudes came from.
    t : (k,) array
        Times since the first joint state of the bag [s].
    names : tuple of str
        Of the channels; they are NaN where their topic was not recorded.
    phases : tuple of (float, str)
        When a phase of the run began [s] and its name; '' where one ended.

    Raises
    ------
    BagError
        When the bag cannot be read, has no state of this robot, or none between start and end.
    StateError, SolverError
        When joints of a mechanism are missing and its loops do not give them.
    """

    def __init__(
        self,
        path: Path,
        robot: Robot,
        source: str = '',
        start: float = -math.inf,
        end: float = math.inf,
        rate: float = RATE,
    ) -> None:
        self.path = path
        self._robot = robot
        self._known = (robot.coordinate_names, described_coordinates(robot))
        wanted = {*STATES.values(), *TORQUES, *DEFLECTIONS, RESIDUAL}
        recorded = read_run(path, wanted, (start, end), rate)
        if end < 0.0 or start > recorded.length:
            raise BagError(
                f'{path}: run must have moments from {start:g} to {end:g} s, '
                f'got one of {recorded.length:.3g} s'
            )
        self.phases = recorded.marks()
        self.source, rows = self._state(recorded, source)
        self.t = rows.t
        self.q, self._qd = self._coordinates(rows)
        self._torque = self._find_torque(recorded)
        found = self._find_channels(recorded)
        self._channels = {name: column for name, column in found if np.isfinite(column).any()}
        self.names = tuple(self._channels)

    def __len__(self) -> int:
        """Return how many moments there are."""
        return len(self.t)

    @overload
    def __getitem__(self, index: int) -> Snapshot: ...

    @overload
    def __getitem__(self, index: slice) -> list[Snapshot]: ...

    def __getitem__(self, index: int | slice) -> Snapshot | list[Snapshot]:
        """Return one moment, or a list of them."""
        if isinstance(index, slice):
            return [self[k] for k in range(*index.indices(len(self)))]
        return Snapshot(
            t=float(self.t[index]),
            q=self.q[index].copy(),
            qd=None if self._qd is None else self._qd[index].copy(),
            torque=_known(self._torque, index) or None,
            channels={name: float(column[index]) for name, column in self._channels.items()},
        )

    def at(self, t: Array) -> Array:
        """Return the coordinates (m, n) at times (m,) [s], linearly between the moments."""
        return np.column_stack([np.interp(t, self.t, column) for column in self.q.T])

    @property
    def span(self) -> tuple[float, float]:
        """From the first phase's begin to the last one's end [s], or all where none is named."""
        first, last = float(self.t[0]), float(self.t[-1])
        begun = [t for t, name in self.phases if name]
        ended = self.phases[-1][0] if self.phases and not self.phases[-1][1] else last
        start, end = max(first, begun[0] if begun else first), min(last, ended)
        return (start, end) if start < end else (first, last)

    def moments(self, count: int) -> Array:
        """Return times (count,) [s], evenly over the phases, or over all where none is named.

        Those between the first and the last of several phases are in the middle of their shares:
        a session's phases are equally long, and all begin alike.
        """
        first, last = self.span
        marks = pairwise([*self.phases, (last, '')])
        inside = [(max(t, first), min(end, last)) for (t, name), (end, _) in marks if name]
        spans = np.array([(begin, end) for begin, end in inside if end > begin])
        if not len(spans):
            return np.linspace(first, last, count)
        lengths = spans[:, 1] - spans[:, 0]
        before = np.cumsum(lengths) - lengths
        # where a phase ends, the next one or none has begun
        along = np.linspace(0.0, (1.0 - INSIDE) * lengths.sum(), count)
        if len(spans) > 1 and count > 2:
            along[1:-1] -= 0.5 * along[1]
        which = np.searchsorted(before, along, side='right') - 1
        return np.asarray(spans[which, 0] + along - before[which])

    def phase(self, t: float) -> str:
        """Return the name of the phase at a time [s], '' outside of all."""
        return next((name for start, name in reversed(self.phases) if start <= t), '')

    def phase_span(self, name: str) -> tuple[float, float]:
        """Return begin and end [s] of the phase of that name.

        Raises
        ------
        ConfigError
            When the run has no such phase among its moments.
        """
        first, last = float(self.t[0]), float(self.t[-1])
        ends = [t for t, _ in self.phases[1:]] + [last]
        spans = {
            each: (max(begin, first), min(end, last))
            for (begin, each), end in zip(self.phases, ends, strict=True)
            if each and begin < last and end > first
        }
        if name not in spans:
            known = ', '.join(map(repr, spans)) or 'a run without phases'
            raise ConfigError(
                f'{self.path}: phases', [f'each must be one of {known}, got {name!r}']
            )
        return spans[name]

    def channel(self, name: str) -> Array:
        """Return a channel at all moments, (k,)."""
        return self._channels[name]

    def _state(self, recorded: RecordedTopics, wanted: str) -> tuple[str, JointSeries]:
        if wanted and wanted not in STATES:
            raise BagError(f'source must be one of {", ".join(STATES)}, got {wanted!r}')
        for source in (wanted,) if wanted else STATES:
            rows = recorded.joints(STATES[source])
            if rows is None:
                continue
            names = self._recorded(source, rows)
            if names and len((whole := rows.ascending().complete(names)).t):
                return source, without_turns(whole, self._robot.tree)
        asked = f'{STATES[wanted]}' if wanted else 'a modal state or joint_states'
        raise BagError(
            f'{self.path}: bag must have {asked} of robot {self._robot.tree.name!r} '
            f'({", ".join(self._robot.joint_names)}), got topics '
            f'{", ".join(recorded.topics) or "(none)"}'
        )

    def _recorded(self, source: str, rows: JointSeries) -> list[str]:
        """Return the coordinates to be taken from a topic; none where it is of another robot."""
        described = {name for known in self._known for name in known}
        if any('/' in name and name not in described for name in rows.names):
            return []  # of beams that are described otherwise
        for known in self._known:
            if set(known) <= set(rows.names):
                return list(known)
        joints = self._robot.joint_names if source == 'joints' else ()
        return [name for name in joints if name in rows.names]

    def _coordinates(self, rows: JointSeries) -> tuple[Array, Array | None]:
        robot = self._robot
        for known in self._known:
            if set(known) <= set(rows.names):
                q, qd = np.zeros((2, len(rows.t), robot.n))
                places = [robot.coordinate_names.index(name) for name in known]
                chosen = rows.select(known)
                q[:, places], qd[:, places] = chosen.position, chosen.velocity
                return q, qd if np.isfinite(qd).all() else None
        q = np.zeros((len(rows.t), robot.n))
        if set(robot.joint_names) <= set(rows.names):
            q[:, robot.joint_indices] = rows.select(robot.joint_names).position
            return q, None
        driven = [name for name in robot.tree.non_mimic_joints if name in rows.names]
        motion = driven_motion(robot, driven, flexible=False)
        now = motion.posture.copy()
        given = np.ascontiguousarray(rows.select(driven).position)
        for row, measured in zip(q, given, strict=True):
            motion.positions(now, measured)
            row[:] = now
        return q, None

    def _find_torque(self, recorded: RecordedTopics) -> dict[str, Array]:
        for topic in TORQUES:
            rows = recorded.joints(topic)
            if rows is None:
                continue
            names = [name for name in self._robot.joint_names if name in rows.names]
            effort = rows.ascending().field('effort').select(names)
            if np.isfinite(effort.values).any():
                return dict(zip(names, effort.at(self.t).T, strict=True))
        return {}

    def _find_channels(self, recorded: RecordedTopics) -> Iterator[tuple[str, Array]]:
        found = {what: recorded.joints(topic) for topic, what in DEFLECTIONS.items()}
        present = {
            what: rows.ascending().field('position')
            for what, rows in found.items()
            if rows is not None
        }
        for name in notable_deflections(_peaks(present), least=1e-12):
            for what, series in present.items():
                if name in series.names:
                    values = series.select([name]).at(self.t)[:, 0]
                    yield deflection_channel(what, name), values
        torques = torque_channels(self._robot.tree)
        for name, values in self._torque.items():
            yield torques[name], values
        if (residual := recorded.joints(RESIDUAL)) is not None:
            columns = residual.ascending().field('position').at(self.t).T
            for name, values in zip(residual.names, columns, strict=True):
                yield residual_channel(name), values


def _known(columns: Mapping[str, Array], index: int) -> dict[str, float]:
    row = {name: float(column[index]) for name, column in columns.items()}
    return {name: value for name, value in row.items() if math.isfinite(value)}


def _peaks(present: Mapping[str, Series]) -> dict[str, float]:
    """Return the largest magnitude of each deflection, whoever tells it."""
    peaks: dict[str, float] = {}
    for series in present.values():
        for name, column in zip(series.names, series.values.T, strict=True):
            largest = float(np.nanmax(np.abs(column), initial=0.0))
            peaks[name] = max(peaks.get(name, 0.0), largest)
    return peaks


def notable_deflections(peaks: Mapping[str, float], least: float = 0.0) -> list[str]:
    """Deflections with a peak [m, rad] beyond the least one, and not negligible among others."""
    largest: dict[str, float] = {}
    for name, peak in peaks.items():
        unit = deflection_unit(name)
        largest[unit] = max(largest.get(unit, 0.0), peak)
    return [
        name
        for name, peak in peaks.items()
        if name.rpartition('/')[2] in SHOWN_COMPONENTS
        and peak > max(NEGLIGIBLE * largest[deflection_unit(name)], least)
    ]
