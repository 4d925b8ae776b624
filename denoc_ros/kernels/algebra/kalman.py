"""Kalman filters: corrections by scalar values, and filters whose matrices change with time.

Between stamps k - 1 and k states go with transitions[k - 1]; where starts[k], they begin anew.
"""

import numpy as np

from denoc_ros.kernels.jit.compiled import inlined, kernel, rows_kernel


@inlined
def take_each(covariance, rows, noise, values, gate, state, gain, taken):
    """Take values as :func:`take_values` does."""
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


@kernel(
    'int64(float64[:, ::1], float64[:, ::1], float64[::1], float64[::1], float64, '
    'float64[::1], float64[::1], float64[::1])'
)
def take_values(covariance, rows, noise, values, gate, state, gain, taken):
    """Correct state (s) and covariance (s, s) in place; return how many values were taken.

    Value k, with standard deviation noise[k], reads rows[k] . state. taken[k]: 1, or 0 where its
    innovation lay beyond gate standard deviations.
    """
    return take_each(covariance, rows, noise, values, gate, state, gain, taken)


@kernel(
    'int64(float64[:, ::1], int64[::1], float64[::1], float64[::1], float64[:, ::1], '
    'float64[:, ::1], float64[::1], float64[::1], float64[:, ::1], float64, float64, float64, '
    'float64, float64[::1], float64[::1], float64[::1])'
)
def take_readings(
    covariance, places, values, constant, shapes, moved, noise, beyond, bending, lag,
    timing_error, model_error, gate, state, change, taken,
):  # fmt: skip
    """Correct amplitudes, rates and loads by readings of one time; return how many were taken.

    Parameters
    ----------
    covariance : (s, s) array
        Of x = [d; d'; f; others]: in place.
    places : (k,) int array
        Which of the sensors were read.
    values : (k,) array
        Their readings.
    constant : (sensors,) array
        Parts of them that do not depend on x.
    shapes, moved : (sensors, m) and (sensors, 3 m) arrays
        Derivatives by d, and others by [d; d'; f].
    noise, beyond : (sensors,) arrays
        Standard deviations; parts of the readings beyond the beams' shapes.
    bending : (m, m) array
        Accelerations of d by itself.
    lag : float
        By how much the covariance is of later than the readings [s].
    timing_error, model_error, gate : float
        Standard deviation of stamps [s], error of the model as a share, standard deviations of an
        innovation beyond which a reading is refused.
    state : (s,) array
        Expected at the time of the readings; output: as corrected.
    change : (s,) array
        Output: the correction.
    taken : (k,) array
        Output: 1, or 0 for a refused one.
    """
    m, count = shapes.shape[1], places.shape[0]
    for i in range(m):
        state[i] += lag * state[m + i]
    for i in range(state.shape[0]):
        change[i] = -state[i]
    rows, gain = np.zeros((count, state.shape[0])), np.empty(state.shape[0])
    left, deviations, bent = np.empty(count), np.empty(count), np.empty(m)
    for k in range(count):
        place = places[k]
        left[k] = values[k] - constant[place]
        for i in range(3 * m):
            rows[k, i] = moved[place, i]
        speed = 0.0
        for i in range(m):
            rows[k, i] += shapes[place, i]
            speed += rows[k, i] * state[m + i]
        square = noise[place] ** 2 + (timing_error * speed) ** 2
        square += (model_error * beyond[place]) ** 2
        if lag > 0.0:  # the line from then to now errs by the acceleration
            for j in range(m):
                bent[j] = 0.0
                for i in range(m):
                    bent[j] += 0.5 * lag * lag * rows[k, i] * bending[i, j]
            for i in range(m):
                for j in range(m):
                    square += bent[i] * covariance[i, j] * bent[j]
            for i in range(m):
                rows[k, m + i] -= lag * rows[k, i]
        deviations[k] = np.sqrt(square)
    found = take_each(covariance, rows, deviations, left, gate, state, gain, taken)
    for i in range(state.shape[0]):
        change[i] += state[i]
    return found


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


@inlined
def carry_covariance(transition, covariance, room):
    """Replace a covariance (s, s) by transition @ covariance @ transition.T."""
    s = covariance.shape[0]
    carried(transition, covariance, room)
    for i in range(s):
        for j in range(s):
            room[i, j] = covariance[j, i]
    for i in range(s):
        for j in range(s):
            covariance[i, j] = room[i, j]
    carried(transition, covariance, room)


@kernel(
    'void(float64[:, ::1], float64[:, ::1], float64[:, ::1], float64[:, ::1], float64[::1], '
    'int64[::1], float64[::1], float64[::1], float64, float64, float64, float64[::1], int64)'
)
def predict_covariance(
    covariance, transition, room, shape, stiffness, first, amplitudes, rates, omega, error, decay,
    floor, steps,
):  # fmt: skip
    """Let the covariance of x = [d; d'; f; others] go on by some steps.

    Loads f have the deviation `error` times the force of the first mode of their deformation at
    its present vibration, at least `floor`.

    Parameters
    ----------
    covariance, transition, room : (s, s) arrays
        In place; of a step; workspace.
    shape : (m, m) array
        Covariance of the loads at unit deviation.
    stiffness, first : (m,) arrays
        Of the amplitudes; the first amplitude of the same deformation.
    amplitudes, rates : (m,) arrays
    omega, error, decay : float
        Frequency of the vibration [rad/s]; a share; factor of the loads over a step.
    floor : (m,) array
    steps : int
    """
    m = shape.shape[0]
    deviation = np.empty(m)
    for i in range(m):
        k = first[i]
        force = stiffness[k] * np.hypot(amplitudes[k], rates[k] / omega)
        deviation[i] = np.hypot(error * force, floor[i])
    for _ in range(steps):
        carry_covariance(transition, covariance, room)
        for i in range(m):
            for j in range(m):
                added = (1.0 - decay * decay) * deviation[i] * shape[i, j] * deviation[j]
                covariance[2 * m + i, 2 * m + j] += added


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
            carry_covariance(transitions[k - 1], spread, room)
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
