"""Measured modes at some postures, as a file, and between the postures.

A robot whose beams nobody knows rings all the same: an accelerometer tells at which frequencies,
posture by posture. Input shapers need no more than that.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator

from denoc_ros.errors import ConfigError
from denoc_ros.types import Array
from denoc_ros.yaml_text import read_yaml_file

ROW = ('position', 'frequency', 'damping_ratio')
MOST_POSTURES = 1000  # the interpolation solves for as many weights


@dataclass(frozen=True, eq=False)
class ModeTable:
    """Natural frequencies and damping ratios over postures.

    Parameters
    ----------
    joints : sequence of str
        Those that the postures differ in; others do not matter.
    positions : (m, joints) array
        The postures [rad, m].
    frequencies : (m, k) array
        Undamped natural frequencies [Hz], ascending at each posture.
    ratios : (m, k) array
        Damping ratios.
    name : str
        What messages call it.

    Raises
    ------
    ConfigError
        With every finding.

    Notes
    -----
    Between postures the logarithm of a frequency and the damping ratio are sums of distances to
    the postures, each joint in terms of its range in the table (a polyharmonic spline of order
    1): piecewise linear for one joint, exact at the postures, for any number of them anywhere.
    Beyond the ranges the nearest posture within counts; no value leaves the range of the table's.
    """

    joints: tuple[str, ...]
    positions: Array
    frequencies: Array
    ratios: Array
    name: str = 'table of modes'

    def __post_init__(self) -> None:
        if findings := self._findings():
            raise ConfigError(self.name, findings)

    @cached_property
    def _values(self) -> Array:
        """Interpolated values: logarithms of the frequencies, then ratios (m, 2 k)."""
        return np.hstack([np.log(self.frequencies), self.ratios])

    @cached_property
    def _interpolated(self) -> Callable[[Array], Array]:
        """Return values (1, 2 k) at shares (1, joints) of the ranges of the joints that differ."""
        if not self._differs.any():
            return lambda _: self._values[:1]
        spline: Callable[[Array], Array] = RBFInterpolator(
            self._shares(self.positions), self._values, kernel='linear', degree=0
        )
        return spline

    @cached_property
    def _differs(self) -> NDArray[np.bool_]:
        return np.asarray(np.ptp(self.positions, axis=0) > 0.0)

    def _shares(self, positions: Array) -> Array:
        """Return where in their ranges the joints that differ are, within 0 and 1."""
        low, span = self.positions.min(axis=0), np.ptp(self.positions, axis=0)
        differs = self._differs
        return np.asarray(np.clip((positions - low)[:, differs] / span[differs], 0.0, 1.0))

    def _findings(self) -> list[str]:
        found, m = [], len(self.positions)
        if not self.joints or len(set(self.joints)) != len(self.joints):
            found.append(f'joints must be different names, got {list(self.joints)}')
        if not 1 <= m <= MOST_POSTURES:
            found.append(f'postures must be 1 to {MOST_POSTURES}, got {m}')
        if found:
            return found
        frequencies, ratios = self.frequencies, self.ratios
        if not frequencies.size or not (np.isfinite(frequencies) & (frequencies > 0.0)).all():
            found.append(f'frequency must be > 0 Hz, got {frequencies.tolist()}')
        elif (np.diff(frequencies, axis=1) < 0.0).any():
            found.append(f'frequency must ascend at each posture, got {frequencies.tolist()}')
        if not (np.isfinite(ratios) & (ratios >= 0.0) & (ratios < 1.0)).all():
            found.append(f'damping_ratio must be >= 0 and < 1, got {ratios.tolist()}')
        if not np.isfinite(self.positions).all():
            found.append(f'position must be finite, got {self.positions.tolist()}')
        elif len(np.unique(self.positions, axis=0)) < m:
            found.append('position must differ from posture to posture, got one twice')
        return found

    def at(self, joint_names: Sequence[str], q_joints: Array) -> tuple[Array, Array]:
        """Return natural frequencies [Hz] and damping ratios, each (k,), at a posture.

        Parameters
        ----------
        joint_names : sequence of str
        q_joints : (joints,) array
            Their positions [rad, m].

        Raises
        ------
        ConfigError
            A joint of the table is not among them.
        """
        unknown = [name for name in self.joints if name not in joint_names]
        if unknown:
            rule = f'joints must be of the robot ({", ".join(joint_names)}), got {unknown}'
            raise ConfigError(self.name, [rule])
        places = [list(joint_names).index(name) for name in self.joints]
        own = np.asarray(q_joints, dtype=np.float64)[places]
        (row,) = self._interpolated(self._shares(own[None]))
        row = np.clip(row, self._values.min(axis=0), self._values.max(axis=0))
        count = self.frequencies.shape[1]
        return np.exp(row[:count]), row[count:]

    def text_values(self) -> dict[str, Any]:
        """Return the file's content."""
        rows = zip(self.positions, self.frequencies, self.ratios, strict=True)
        return {
            'joints': list(self.joints),
            'postures': [
                {name: value.tolist() for name, value in zip(ROW, row, strict=True)}
                for row in rows
            ],
        }


def read_mode_table(path: str | Path) -> ModeTable:
    """Return the table of a YAML file.

    Raises
    ------
    ConfigError
        It cannot be read, or has other keys or numbers; with every finding.
    """
    file = Path(path)
    values = read_yaml_file(file)
    if not isinstance(values, Mapping) or set(values) != {'joints', 'postures'}:
        raise ConfigError(str(file), ["must have the keys 'joints' and 'postures'"])
    joints, rows = values['joints'], values['postures']
    findings = []
    if not isinstance(joints, list) or not all(isinstance(name, str) for name in joints):
        findings.append(f'joints must be a list of names, got {joints!r}')
    if not isinstance(rows, list) or not rows:
        findings.append('postures must be a list of one or more')
    else:
        for place, row in enumerate(rows):
            if rule := _row_finding(row, joints, rows[0]):
                findings.append(f'postures[{place}]: {rule}')
    if findings:
        raise ConfigError(str(file), findings)
    positions, frequencies, ratios = (
        np.array([row[name] for row in rows], dtype=np.float64) for name in ROW
    )
    return ModeTable(tuple(joints), positions, frequencies, ratios, str(file))


def _row_finding(row: Any, joints: Any, first: Any) -> str:
    """Return the fault of a posture; '' where there is none."""
    if not isinstance(row, Mapping) or set(row) != set(ROW):
        return f'must have the keys {", ".join(ROW)}, got {row!r:.80}'
    for name in ROW:
        values = row[name]
        is_numbers = isinstance(values, list) and all(
            isinstance(value, (int, float)) and not isinstance(value, bool) for value in values
        )
        if not is_numbers:
            return f'{name} must be a list of numbers, got {values!r:.80}'
    if isinstance(joints, list) and len(row['position']) != len(joints):
        return f'position must have one number for each of {joints}, got {row["position"]}'
    counts = {len(row['frequency']), len(row['damping_ratio'])}
    known = first.get('frequency') if isinstance(first, Mapping) else None
    counts |= {len(known)} if isinstance(known, list) else set()
    if len(counts) > 1 or 0 in counts:
        return 'frequency and damping_ratio must have as many numbers as those of all postures'
    return ''
