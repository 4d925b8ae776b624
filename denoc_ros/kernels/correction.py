"""Kalman correction of a state and its covariance by scalar values, one after another."""

from denoc_ros.kernels.compiled import kernel


@kernel(
    'int64(float64[:, ::1], float64[:, ::1], float64[::1], float64[::1], float64, float64, '
    'float64[::1], float64[::1], float64[::1])'
)
def take_values(covariance, rows, noise, values, gate, lag, state, gain, taken):
    """Correct state (s) and covariance (s, s) in place; return how many values were taken.

    Value k, with standard deviation noise[k], reads rows[k] . (d - lag d') of the state's first
    m elements d and the next m, d'. taken[k]: 1, or 0 where its innovation lay beyond gate
    standard deviations.
    """
    size = state.shape[0]
    m = rows.shape[1]
    count = 0
    for k in range(values.shape[0]):
        innovation = values[k]
        for j in range(m):
            innovation -= rows[k, j] * (state[j] - lag * state[m + j])
        for i in range(size):
            gain[i] = 0.0
            for j in range(m):
                gain[i] += rows[k, j] * (covariance[i, j] - lag * covariance[i, m + j])
        variance = noise[k] * noise[k]
        for j in range(m):
            variance += rows[k, j] * (gain[j] - lag * gain[m + j])
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


@kernel(
    'int64(float64[:, ::1], float64[:, ::1], float64[::1], float64[::1], float64, '
    'float64[::1], float64[::1], float64[::1])'
)
def take_rows(covariance, rows, noise, values, gate, state, gain, taken):
    """As `take_values`, but value k reads rows[k] . state, over the whole state (s)."""
    size = state.shape[0]
    count = 0
    for k in range(values.shape[0]):
        innovation = values[k]
        for j in range(size):
            innovation -= rows[k, j] * state[j]
        variance = noise[k] * noise[k]
        for i in range(size):
            gain[i] = 0.0
            for j in range(size):
                gain[i] += rows[k, j] * covariance[i, j]
            variance += rows[k, i] * gain[i]
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
