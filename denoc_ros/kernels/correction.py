"""Kalman correction of a state and its covariance by scalar values, one after another."""

from denoc_ros.kernels.compiled import kernel


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
