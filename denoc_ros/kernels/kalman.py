"""Kalman filters: corrections by scalar values, and filters whose matrices change with time.

Between stamps k - 1 and k states go with transitions[k - 1]; where starts[k], they begin anew.
"""

import numpy as np

from denoc_ros.kernels.compiled import inlined, kernel, rows_kernel


@kernel(
    'int64(float64[:, ::1], float64[:, ::1], float64[::1], float64[::1], float64, '
    'float64[::1], float64[::1], float64[::1])'
)
def take_values(covariance, rows, noise, values, gate, state, gain, taken):
    """Correct state (s) and covariance (s, s) in place; return how many values were taken.

    Value k, with standard deviation noise[k], reads rows[k] . state. taken[k]: 1, or 0 where its
    innovation lay beyond gate standard deviations.
    """
    size = state.shape[0]
    count = 0
    for k in range(values.shape[0]):
        innovation = values[k]
        for i in range(size):
            gain[i] = 0.0
        for j in range(size):
            row = rows[k, j]
            if row == 0.0:
                continue
            innovation -= row * state[j]
            for i in range(size):
                gain[i] += row * covariance[j, i]
        variance = noise[k] * noise[k]
        for j in range(size):
            variance += rows[k, j] * gain[j]
        if not innovation * innovation <= gate * gate * variance:
            taken[k] = 0.0
            continue
        taken[k] = 1.0
        count += 1
        for i in range(size):
            share = gain[i] / variance
            state[i] += share * innovation
            for j in range(size):
                covariance[i, j] -= share * gain[j]
    return count


@inlined
def carried(transition, states, room):
    """Replace states (s, c) by transition @ states."""
    s, c = states.shape
    for i in range(s):
        for j in range(c):
            room[i, j] = states[i, j]
            states[i, j] = 0.0
    for i in range(s):
        for k in range(s):
            a = transition[i, k]
            for j in range(c):
                states[i, j] += a * room[k, j]


@rows_kernel('void(float64[:, :, ::1], boolean[::1], float64[:, ::1])')
def linear_states(transitions, starts, states):
    """Add to each state (k, s) the propagation of the one before, but at starts."""
    count, s = states.shape
    for k in range(1, count):
        if starts[k]:
            continue
        for i in range(s):
            total = states[k, i]
            for j in range(s):
                total += transitions[k - 1, i, j] * states[k - 1, j]
            states[k, i] = total


@rows_kernel(
    'void(float64[:, :, ::1], boolean[::1], float64[:, :, ::1], int64[::1], int64[::1], '
    'float64[:, ::1], float64[:, ::1], float64[::1])'
)
def filter_gains(transitions, starts, noise, edges, order, slopes, gains, deviations):
    """Write gains (m, s) of a Kalman filter, and deviations (m) of its innovations.

    Rows order[edges[k]] .. order[edges[k + 1] - 1] are measured at stamp k, one after the other,
    with slopes (m, s) by the states; deviations has those of their own noise before. noise (k, s,
    s) is what each interval adds to the states' covariance.
    """
    s = slopes.shape[1]
    spread, room, shared = np.zeros((s, s)), np.zeros((s, s)), np.zeros(s)
    for k in range(starts.shape[0]):
        if starts[k]:
            spread[:] = 0.0
        else:
            carried(transitions[k - 1], spread, room)
            for i in range(s):
                for j in range(s):
                    room[i, j] = spread[j, i]
            for i in range(s):
                for j in range(s):
                    spread[i, j] = room[i, j]
            carried(transitions[k - 1], spread, room)
            for i in range(s):
                for j in range(s):
                    spread[i, j] += noise[k, i, j]
        for place in range(edges[k], edges[k + 1]):
            row = order[place]
            variance = deviations[row] ** 2
            for i in range(s):
                shared[i] = 0.0
                for j in range(s):
                    shared[i] += spread[i, j] * slopes[row, j]
                variance += shared[i] * slopes[row, i]
            deviations[row] = np.sqrt(variance)
            for i in range(s):
                gains[row, i] = shared[i] / variance
                for j in range(s):
                    spread[i, j] -= gains[row, i] * shared[j]


@rows_kernel(
    'void(float64[:, :, ::1], boolean[::1], int64[::1], int64[::1], float64[:, ::1], '
    'float64[:, ::1], float64[::1], float64[:, ::1])'
)
def filter_values(transitions, starts, edges, order, slopes, gains, deviations, values):
    """Replace values (m, c) by their innovations over these deviations."""
    s, c = slopes.shape[1], values.shape[1]
    states, room, missed = np.zeros((s, c)), np.zeros((s, c)), np.zeros(c)
    for k in range(starts.shape[0]):
        if starts[k]:
            states[:] = 0.0
        else:
            carried(transitions[k - 1], states, room)
        for place in range(edges[k], edges[k + 1]):
            row = order[place]
            for j in range(c):
                missed[j] = values[row, j]
            for i in range(s):
                slope = slopes[row, i]
                for j in range(c):
                    missed[j] -= slope * states[i, j]
            for i in range(s):
                gain = gains[row, i]
                for j in range(c):
                    states[i, j] += gain * missed[j]
            for j in range(c):
                values[row, j] = missed[j] / deviations[row]
