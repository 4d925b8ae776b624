"""Torques of a state feedback about a plan, and how much of them the joints can stand against."""

import numpy as np

from denoc_ros.kernels.jit.compiled import inlined, kernel


@inlined
def gain_between(before, after, share, i, j):
    """Return an element of a gain a share of the way from one to another."""
    return (1.0 - share) * before[i, j] + share * after[i, j]


@kernel(
    'void(float64[:, ::1], float64[:, ::1], float64[:, ::1], float64[:, ::1], float64, '
    'float64[:, ::1], float64[::1], float64[::1], float64[::1], float64[::1], float64[::1], '
    'float64[::1], float64[::1], float64[::1], float64[::1])'
)
def feedback_torques(
    gain, next_gain, joint_gain, next_joint_gain, share, measured, state, joints, changed_state,
    changed, way, integrals, deviations, torque, joint_torque,
):  # fmt: skip
    """Write the torque by all deviations from a plan that is changed, and that of the joints' own.

    Parameters
    ----------
    gain, next_gain : (k, s + past + k) arrays
        At the postures about this one.
    joint_gain, next_joint_gain : (k, 2 k) arrays
    share : float
        Of the way from one posture to the next.
    measured : (2 k or more, s or more) array
        The joints' deviations and their rates by all deviations, in the first rows and columns.
    state : (s or more,) array
        Deviations from the plan, first.
    joints : (2 k,) array
        Those of the joints and their rates, as measured.
    changed_state, changed : (s,) and (k,) arrays
        By how much deviations and torque of the plan in use are others.
    way, integrals : (past,) and (k,) arrays
        Torques on their way, beyond the plan's; integrals of the virtual joint errors.
    deviations : (s,) array
        Output: from the plan in use.
    torque, joint_torque : (k,) arrays
        Output [N m, N].
    """
    count, size, past = len(torque), len(deviations), len(way)
    for j in range(size):
        deviations[j] = state[j] - changed_state[j]
    off = np.empty(len(joints))
    for i in range(len(joints)):
        off[i] = joints[i]
        for j in range(size):
            off[i] -= measured[i, j] * changed_state[j]
    for i in range(count):
        torque[i] = joint_torque[i] = 0.0
        for j in range(size):
            torque[i] -= gain_between(gain, next_gain, share, i, j) * deviations[j]
        for j in range(past):
            pushed = way[j] - changed[j % count]
            torque[i] -= gain_between(gain, next_gain, share, i, size + j) * pushed
        for j in range(count):
            torque[i] -= gain_between(gain, next_gain, share, i, size + past + j) * integrals[j]
        for j in range(len(joints)):
            joint_torque[i] -= gain_between(joint_gain, next_joint_gain, share, i, j) * off[j]


@inlined
def share_within(torque, most):
    """Return the share of a torque (k,) that is within limits, at most 1."""
    share = 1.0
    for i in range(len(torque)):
        share = min(share, most[i] / max(abs(torque[i]), most[i] * 1e-12 + 1e-300))
    return share


@kernel('float64(float64[::1], float64[::1], float64[:, ::1], float64, float64)')
def govern(torque, last, gain, reach, change):
    """Lessen a torque (k,) so that joints stand against it, and its change; all of it together.

    Parameters
    ----------
    torque : (k,) array
        In place.
    last : (k,) array
        What it was before.
    gain : (k, 2 k) array
        Of the joints.
    reach : float
        How far the torque may push them from the plan [rad, m].
    change : float
        Share of the most that it may have by which it may change.

    Returns
    -------
    float
        The share of the torque that the joints can stand against, at most 1; -1 if they have no
        gain: then it stays as it is.
    """
    count, largest = len(torque), 0.0
    most = np.zeros(count)
    for i in range(count):
        for j in range(count):
            most[i] += reach * abs(gain[i, j])
        largest = max(largest, most[i])
    if largest == 0.0:
        return -1.0
    share = share_within(torque, most)
    step = np.empty(count)
    for i in range(count):
        step[i] = share * torque[i] - last[i]
        most[i] *= change
    part = share_within(step, most)
    for i in range(count):
        torque[i] = last[i] + part * step[i]
    return share
