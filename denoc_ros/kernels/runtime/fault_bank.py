"""A bank of Kalman filters that each use some of the same values: its steps, one call each.

Filter h has the state x = [d; d'; f; b; e] of deviations (s,), with m amplitudes d, rates and
forces, constant errors b of values, and steady shares e (m,) of the elastic forces.
"""

import numpy as np

from denoc_ros.kernels.jit.compiled import kernel


@kernel(
    'void(float64[:, ::1], float64[:, :, ::1], float64[:, ::1], float64[:, ::1], float64[::1], '
    'float64[::1], float64[:, ::1], float64[:, ::1])'
)
def advance_filters(
    states, covariances, alone, pushed, stiffness, amplitudes, load_noise, share_noise
):
    """Bring all filters forward by some steps.

    Parameters
    ----------
    states, covariances : (h, s) and (h, s, s) arrays
        In place.
    alone, pushed : (3 m, 3 m) and (3 m, m) arrays
        Transition of [d; d'; f], and its change by steady forces.
    stiffness, amplitudes : (m,) arrays
        The latter are those that the deviations are from.
    load_noise, share_noise : (m, m) arrays
        What the covariances of f and e gain.
    """
    count, size = states.shape
    m = stiffness.shape[0]
    moved, first = 3 * m, size - m
    transition = np.zeros((moved, size))
    room, state = np.zeros((size, size)), np.zeros(size)
    for i in range(moved):
        for j in range(moved):
            transition[i, j] = alone[i, j]
    for h in range(count):
        covariance = covariances[h]
        for j in range(m):
            force = stiffness[j] * (amplitudes[j] + states[h, j])
            for i in range(moved):
                transition[i, first + j] = pushed[i, j] * force
        for i in range(moved):
            total = 0.0
            for j in range(size):
                total += transition[i, j] * states[h, j]
            state[i] = total
            for j in range(size):
                room[i, j] = 0.0
            for k in range(size):
                factor = transition[i, k]
                if factor != 0.0:
                    for j in range(size):
                        room[i, j] += factor * covariance[k, j]
        for i in range(moved):
            states[h, i] = state[i]
            for j in range(i + 1):
                total = 0.0
                for k in range(size):
                    total += room[i, k] * transition[j, k]
                covariance[i, j] = total
                covariance[j, i] = total
            for j in range(moved, size):
                covariance[i, j] = room[i, j]
                covariance[j, i] = room[i, j]
        for i in range(m):
            for j in range(m):
                covariance[2 * m + i, 2 * m + j] += load_noise[i, j]
                covariance[first + i, first + j] += share_noise[i, j]


@kernel(
    'void(float64[:, ::1], float64[:, :, ::1], float64[:, ::1], float64[::1], float64[::1], '
    'boolean[:, ::1], float64, float64[:, ::1], float64[:, ::1], float64[:, ::1])'
)
def compare_filters(
    states, covariances, rows, values, squares, used, clip, innovations, variances, chi
):
    """Compare values of one time with all filters, and correct these.

    Parameters
    ----------
    states, covariances : (h, s) and (h, s, s) arrays
        In place.
    rows : (k, s) array
        Derivatives of the values by the state.
    values, squares : (k,) arrays
        The values of the deviations, and the variances of their errors.
    used : (h, k) bool array
        Which values a filter uses.
    clip : float
        Largest chi-squared of a value that counts: a filter is moved no further than by that.
    innovations, variances : (h, k) arrays
        Output: of all values, before the correction.
    chi : (h, k) array
        Output: chi-squared of each value after those before it, at most the clip; 0 of others.
    """
    count, size = states.shape
    number = rows.shape[0]
    gain = np.zeros(size)
    for h in range(count):
        for k in range(number):
            missed, variance = values[k], squares[k]
            for j in range(size):
                row = rows[k, j]
                if row != 0.0:
                    missed -= row * states[h, j]
                    for i in range(size):
                        variance += row * covariances[h, j, i] * rows[k, i]
            innovations[h, k], variances[h, k] = missed, variance
        for k in range(number):
            chi[h, k] = 0.0
            if not used[h, k]:
                continue
            missed, variance = values[k], squares[k]
            for i in range(size):
                gain[i] = 0.0
            for j in range(size):
                row = rows[k, j]
                if row != 0.0:
                    missed -= row * states[h, j]
                    for i in range(size):
                        gain[i] += row * covariances[h, j, i]
            for j in range(size):
                variance += rows[k, j] * gain[j]
            square = missed * missed / variance
            weight = 1.0 if square <= clip else clip / square
            chi[h, k] = weight * square
            for i in range(size):
                share = weight * gain[i] / variance
                states[h, i] += share * missed
                for j in range(size):
                    covariances[h, i, j] -= share * gain[j]
