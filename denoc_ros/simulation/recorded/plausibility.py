"""Plausibility of recorded joints: positions that jump, and efforts that are no joint torques."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from denoc_ros.estimation.turns import TURN
from denoc_ros.model.tree import JointKind, Tree
from denoc_ros.types import Array, Flags, Stamps

LONGEST_GAP_S = 0.5  # After a longer gap a motion begins anew,
LONGEST_GAP_PERIODS = 5  # if it is also longer than so many periods.
JUMP_FACTOR = 10  # A jump is so many times longer than the way that the rate explains,
LEAST_JUMP = 0.01  # and at least so much longer [rad, m].
TURN_TOLERANCE = 0.05  # Share of a turn by which a jump by turns may differ from them.
SAMPLE_ROWS = 5  # A jump that is taken back within so many rows is wild samples.
SAMPLE_RETURN = 0.2  # Share of a jump that may remain after it was taken back.
SCALE_CORRELATION = 0.95  # An effort that is so alike to the torque is a multiple of it.
SCALES = (0.5, 2.0)  # Smallest and largest multiple that errors of a model explain.
MOST_RESIDUAL = 1.5  # A residual of more times the effort is no error of a model.
FITTED_SHARES = (-0.5, 1.5)  # Shares of an effort that fitted friction or an offset may have.
NOTABLE_GRAVITY = 0.3  # Share of an effort from which on an offset must be smaller than gravity.
VANISHING = 1e-6  # Share of the model's torque below which an effort is none.
LEAST_SAMPLES = 10  # Fewer samples of an effort show nothing.


@dataclass(frozen=True)
class Jump:
    """A step of a joint's position that its rate does not explain.

    Attributes
    ----------
    joint : str
    time : float
        [s]
    size : float
        [rad, m]
    kind : {'turn', 'sample', 'place'}
        By whole turns, though turns of the joint count; to a wild sample, or back; to another
        place, where the motion goes on.
    """

    joint: str
    time: float
    size: float
    kind: str


def jumps_between(t: Array, q: Array, qd: Array | None) -> Flags:
    """Return which steps (k - 1, n) between rows are longer than the rates (k, n) explain.

    Parameters
    ----------
    t : (k,) array
        Stamps [s].
    q, qd : (k, n) array
        Positions, and rates; without rates the steps around take their place.
    """
    steps, intervals = np.abs(np.diff(q, axis=0)), np.diff(t)[:, None]
    if qd is not None:
        rates = np.abs(qd)
        fastest = np.maximum(rates[1:], rates[:-1])
    else:
        around = np.pad(steps / intervals, ((SAMPLE_ROWS, SAMPLE_ROWS), (0, 0)))
        windows = sliding_window_view(around, 2 * SAMPLE_ROWS + 1, axis=0)
        others = np.delete(windows, SAMPLE_ROWS, axis=-1)
        # the fastest of them may be the way back from wild samples
        fastest = np.partition(others, -2, axis=-1)[..., -2]
    jumps: Flags = steps > JUMP_FACTOR * fastest * intervals + LEAST_JUMP
    return jumps


def gaps_between(t: Array, period: float) -> Flags:
    """Return which intervals (k - 1,) between stamps are so long that a motion begins anew."""
    gaps: Flags = np.diff(t) > max(LONGEST_GAP_S, LONGEST_GAP_PERIODS * period)
    return gaps


def angular_joints(tree: Tree, names: Sequence[str]) -> Flags:
    """Return which of some joints of a robot have angles as positions."""
    kinds = [tree.joints[name].kind for name in names]
    return np.array([kind is not JointKind.PRISMATIC for kind in kinds], dtype=bool)


def found_jumps(
    joints: Sequence[str],
    t: Array,
    q: Array,
    jumps: Flags,
    angular: Flags,
    steps_judged: Stamps | None = None,
) -> list[tuple[int, Jump]]:
    """Return the jumps with their kinds and the rows that they lead to, in the order of time.

    Parameters
    ----------
    jumps : (k - 1, n) bool array
        As of :func:`jumps_between`.
    angular : (n,) bool array
        Which positions are angles.
    steps_judged : array of int, optional
        Numbers of the steps that count; default all.
    """
    found = []
    steps = np.diff(q, axis=0)
    judged = np.arange(len(steps)) if steps_judged is None else steps_judged
    for row, joint in ((int(judged[k]), j) for k, j in np.argwhere(jumps[judged]).tolist()):
        size = float(steps[row, joint])
        near = slice(max(0, row - SAMPLE_ROWS), row + SAMPLE_ROWS + 1)
        others = steps[near, joint][jumps[near, joint]]
        turns = size / TURN
        kind = 'place'
        if angular[joint] and abs(turns) > 0.5 and abs(turns - round(turns)) < TURN_TOLERANCE:
            kind = 'turn'
        elif (np.abs(others + size) < SAMPLE_RETURN * abs(size)).any():
            kind = 'sample'
        found.append((row + 1, Jump(joints[joint], float(t[row + 1]), size, kind)))
    return found


def jump_doubts(jumps: Sequence[Jump], kinds: Sequence[str] = ('turn', 'sample')) -> list[str]:
    """Return what jumps of some kinds say against a recording, a line for each joint and kind."""
    rules = {
        'turn': 'position must be without jumps by a turn where the joint is not continuous',
        'sample': 'position must be without wild samples',
        'place': 'position must go on',
    }
    groups: dict[tuple[str, str], list[Jump]] = {}
    for jump in jumps:
        if jump.kind in kinds:
            groups.setdefault((jump.joint, jump.kind), []).append(jump)
    return [
        f'{joint}: {rules[kind]}, got {len(group)} jump{"s" * (len(group) > 1)}, '
        f'the first by {group[0].size:.3g} at {group[0].time:.3f} s'
        for (joint, kind), group in groups.items()
    ]


@dataclass(frozen=True)
class EffortSizes:
    """Measured effort of joints beside the model's torque, all (joints,) arrays.

    Attributes
    ----------
    samples : int array
        Number of samples.
    measured, expected, residual : array
        rms of the effort, of the model's torque without fitted terms, and of their difference
        [N m, N].
    scale, correlation : array
        Multiple of the model's torque that the effort is nearest to, and how alike they are.
    fitted : dict of str to array
        Shares of the effort's mean square that fitted terms explain.
    gravity, offset : array
        rms of the torque of gravity, and the fitted offset's magnitude [N m, N]; zeros where
        nothing was fitted.
    """

    samples: Array
    measured: Array
    expected: Array
    residual: Array
    scale: Array
    correlation: Array
    fitted: dict[str, Array]
    gravity: Array
    offset: Array

    @classmethod
    def of_sums(
        cls, sums: Array, offset: Array | None, fitted: Mapping[str, Array] | None = None
    ) -> EffortSizes:
        """Return the sizes by sums over the samples.

        Parameters
        ----------
        sums : (7, joints) array
            As :func:`effort_sums` gives them.
        offset : (joints,) array or None
            Fitted offset [N m, N]; None where nothing was fitted.
        fitted : mapping of str to (joints,) array, optional
            As the attribute.
        """
        count = np.maximum(sums[0], 1.0)
        y, m, yy, mm, ym, gg = sums[1:] / count
        nothing = np.zeros(len(count))
        with np.errstate(divide='ignore', invalid='ignore'):
            scale = (ym - y * m) / (mm - m * m)
            correlation = (ym - y * m) / np.sqrt((yy - y * y) * (mm - m * m))
        return cls(
            samples=sums[0],
            measured=np.sqrt(yy),
            expected=np.sqrt(mm),
            residual=np.sqrt(np.maximum(yy - 2.0 * ym + mm, 0.0)),
            scale=scale,
            correlation=correlation,
            fitted=dict(fitted or {}),
            gravity=nothing if offset is None else np.sqrt(gg),
            offset=nothing if offset is None else np.abs(offset),
        )


def effort_sums(effort: Array, expected: Array, gravity: Array) -> Array:
    """Return sums (7, joints) over rows of 1, y, m, y^2, m^2, y m and g^2.

    Parameters
    ----------
    effort, expected, gravity : (k, joints) array
        Measured effort y, the model's torque m without fitted terms, and that of gravity g [N m,
        N]; rows without an effort do not count.
    """
    known = np.isfinite(effort)
    y, m, g = (np.where(known, each, 0.0) for each in (effort, expected, gravity))
    return np.array([np.sum(each, axis=0) for each in (known, y, m, y * y, m * m, y * m, g * g)])


def effort_doubts(joints: Sequence[str], sizes: EffortSizes) -> list[str]:
    """Return why measured efforts are not the torques of the joints, in words."""
    found = []
    for k, joint in enumerate(joints):
        if sizes.samples[k] < LEAST_SAMPLES:
            continue
        if reason := _no_torque(sizes, k):
            found.append(f'{joint}: effort must be the torque of the joint, got {reason}')
    return found


def vanishes(measured: float, expected: float) -> bool:
    """Say whether an effort is nothing beside the torque that the motion takes (rms)."""
    return measured <= VANISHING * expected


def _no_torque(sizes: EffortSizes, k: int) -> str:
    """Return what speaks against the effort of a joint, '' for nothing."""
    measured, expected = sizes.measured[k], sizes.expected[k]
    if vanishes(measured, expected):
        least = VANISHING * max(1.0, float(np.max(sizes.expected)))
        if expected <= least:
            return ''
        return f'{measured:.3g} where the model has {expected:.3g} (rms)'
    low, high = SCALES
    if sizes.correlation[k] > SCALE_CORRELATION and not low <= sizes.scale[k] <= high:
        return f'about {sizes.scale[k]:.3g} times that of the model: a current, or another unit'
    for term, shares in sizes.fitted.items():
        low, high = FITTED_SHARES
        if not low <= shares[k] <= high:
            return f'{term} that explains {100.0 * shares[k]:.0f} % of it'
    if NOTABLE_GRAVITY * measured < sizes.gravity[k] <= sizes.offset[k]:
        return (
            f'an offset of {sizes.offset[k]:.3g} beside a gravity of {sizes.gravity[k]:.3g} (rms)'
        )
    if sizes.residual[k] > MOST_RESIDUAL * measured:
        return (
            f'{measured:.3g} where the model has {expected:.3g} and leaves '
            f'{sizes.residual[k]:.3g} (rms)'
        )
    return ''
