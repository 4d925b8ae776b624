"""The filter of deviations from a plan and of the model's errors: its steps, one call each.

Estimates are polynomials of second degree in c errors beside those used: 1 + t coefficients, those
of 1, of each error, and of the t - c products of two. A history is passed as its times, its
states and how many there are.
"""

import math

import numpy as np

from denoc_ros.kernels.constraints.multipliers import solve_factored
from denoc_ros.kernels.dynamics.elimination import factor
from denoc_ros.kernels.jit.compiled import inlined, kernel

# numbers of an estimate of errors
PLAN_STEP, PERIOD, AVERAGED, ENTERS, GROWTH, NONE, RARE, RARELY, UNSURE, LIKELY = range(10)
NUMBERS = 9


@inlined
def place_in(times, end, time):
    """Return the place of the first of so many times that is not before a time."""
    place = end
    while place > 0 and times[place - 1] >= time:
        place -= 1
    return place


@inlined
def line(times, end, time):
    """Return the places before and after a time, and the share of the way between them."""
    if end == 1:
        return 0, 0, 0.0
    after = min(max(place_in(times, end, time), 1), end - 1)
    before = after - 1
    return before, after, (time - times[before]) / (times[after] - times[before])


@inlined
def on_line(states, where, i):
    """Return an element of the state on a line between two of a history."""
    before, after, share = where
    return states[before, i] + share * (states[after, i] - states[before, i])


@kernel(
    'void(float64[::1], int64[::1], float64, float64, float64[::1], float64[:, ::1], int64, '
    'float64[::1], float64[:, ::1], int64, float64[::1], float64[:, ::1], int64, float64[::1], '
    'float64[::1], float64[::1])'
)
def compare(
    values, at, stamp, sample, plan_times, plan, plan_end, times, own, end, second_times, second,
    second_end, innovation, surprise, joints,
):  # fmt: skip
    """Compare measured values, those at places, with the plan at their stamp and two estimates.

    Parameters
    ----------
    values : (measured,) array
    at : (k,) int array
    stamp, sample : float
        Of the values; when the estimates had what belongs to them [s].
    plan_times, plan, plan_end
        History of the plan's values.
    times, own, end
        Of those of the estimate, beyond the plan's.
    second_times, second, second_end
        Of those of the second estimate.
    innovation, surprise : (measured,) arrays
        Output: of both estimates.
    joints : (2 joints,) array
        Output: deviations of the first values.
    """
    planned = line(plan_times, plan_end, stamp)
    first, last = line(times, end, sample), line(second_times, second_end, sample)
    for i in at:
        away = values[i] - on_line(plan, planned, i)
        innovation[i] = away - on_line(own, first, i)
        surprise[i] = away - on_line(second, last, i)
        if i < joints.shape[0]:
            joints[i] = away


@kernel(
    'void(float64[::1], float64[::1], float64[::1], boolean[::1], float64[::1], boolean[::1], '
    'boolean[::1], boolean[::1], float64[::1], int64[::1], float64, float64, int64, '
    'float64[::1], int64, float64[::1])'
)
def sift(
    innovation, spread, reach, wide, stamps, new, good, heard, good_at, refused, now, gate, joints,
    state, size, found,
):  # fmt: skip
    """Leave out values that are too far off, and look at how good the others are.

    Parameters
    ----------
    innovation : (measured,) array
        Output: 0 of what is left out.
    spread, reach : (measured,) arrays
        Standard deviations of innovations; the largest ones within wide bounds.
    wide : (measured,) bool array
        Where wide bounds hold.
    stamps : (measured,) array
        Of the values [s].
    new, good : (measured,) bool arrays
        Which are new: none, afterwards; output: which are new and not left out.
    heard : (measured,) bool array
        Of which good values are to be expected.
    good_at : (measured,) array
        When the last good values were measured [s].
    refused : (sensors,) int array
        How many values of the sensors, the last ones, were left out: in place. No others are.
    now, gate : float
        [s]; standard deviations that an innovation may have.
    joints : int
        How many are measured: the first values, then as many rates, which need not be.
    state, size
        Of the estimate; how many deviations it begins with.
    found : (4,) array
        Output: age of the oldest good values [s] and their place; 1 if all sensors agree within
        the gate, else 0; the largest deviation.
    """
    oldest, place, agrees, first = -np.inf, 0, 1.0, len(innovation) - len(refused)
    for i in range(len(innovation)):
        if i >= first:
            most = gate * spread[i]
            if not abs(innovation[i]) <= (max(most, reach[i]) if wide[i] else most):
                innovation[i], new[i] = 0.0, False
                refused[i - first] += 1
            if not abs(innovation[i]) <= most:
                agrees = 0.0
        good[i] = new[i]
        if new[i]:
            good_at[i] = stamps[i]
        new[i] = False
        age = now - good_at[i] if heard[i] and not joints <= i < 2 * joints else 0.0
        if age > oldest:
            oldest, place = age, i
    largest = 0.0
    for i in range(size):
        if not abs(state[i]) <= largest:  # NaN is no less
            largest = abs(state[i])
    found[0], found[1], found[2], found[3] = oldest, place, agrees, largest


@inlined
def add_measured(measured, change, times, states, end, since):
    """Add what is measured of a change (e,) of the estimate to a history from a time on."""
    begin = place_in(times, end, since)
    for i in range(measured.shape[0]):
        total = 0.0
        for j in range(measured.shape[1]):
            total += measured[i, j] * change[j]
        for k in range(begin, end):
            states[k, i] += total


@kernel(
    'void(float64[:, ::1], float64[:, ::1], float64[::1], int64[::1], float64[::1], '
    'float64[:, ::1], float64[::1], float64[:, ::1], int64, float64)'
)
def correct_estimate(correction, measured, innovation, at, state, seen, times, own, end, since):
    """Correct an estimate by innovations at places, and its history from a time [s] on.

    Parameters
    ----------
    correction : (e, measured) array
    measured : (measured, e) array
    innovation : (measured,) array
    at : (k,) int array
    state : (e,) array
        In place.
    seen : (e, c) array
        How far it is off by unit errors: in place.
    times, own, end, since
        History of what is measured of the estimate: in place.
    """
    size, count = seen.shape
    rows, change = np.zeros((len(at), count)), np.zeros(size)
    for k in range(len(at)):
        for i in range(size):
            read = measured[at[k], i]
            for j in range(count):
                rows[k, j] += read * seen[i, j]
    for i in range(size):
        for k in range(len(at)):
            gain = correction[i, at[k]]
            change[i] += gain * innovation[at[k]]
            for j in range(count):
                seen[i, j] -= gain * rows[k, j]
        state[i] += change[i]
    add_measured(measured, change, times, own, end, since)


@inlined
def move_origin(row, errors):
    """Let a polynomial (1 + t) be one in errors beside others (c,) than before."""
    count = errors.shape[0]
    for i in range(count):
        row[0] += row[1 + i] * errors[i]
    place = 1 + count
    for i in range(count):
        for j in range(i, count):
            product = row[place]
            row[0] += product * errors[i] * errors[j]
            row[1 + i] += product * errors[j]
            row[1 + j] += product * errors[i]
            place += 1


@inlined
def write_changes(table, along, errors, rows):
    """Write polynomials (s, 1 + t) beside errors: of a table (k, s, t) at a fractional row.

    Between rows by cubic convolution (Catmull and Rom). A line has a kink at each row, which
    would show errors that are not there.
    """
    end = table.shape[0] - 1
    along = min(max(along, 0.0), float(end))
    before = min(int(along), end - 1)
    after, share = before + 1, along - before
    first, last, rest = max(before - 1, 0), min(after + 1, end), 1.0 - share
    outer, inner = -0.5 * share * rest * rest, -0.5 * share * share * rest
    toward = share * share * (3.0 - 2.0 * share)
    for i in range(table.shape[1]):
        rows[i, 0] = 0.0
        for j in range(table.shape[2]):
            rows[i, 1 + j] = (
                outer * (table[first, i, j] - table[after, i, j])
                + (1.0 - toward) * table[before, i, j]
                + toward * table[after, i, j]
                + inner * (table[last, i, j] - table[before, i, j])
            )
        move_origin(rows[i], errors)


@kernel(
    'void(float64[:, :, ::1], float64[:, :, ::1], float64, float64[::1], float64[::1], '
    'float64[::1])'
)
def plan_changes(states, torques, along, errors, state, torque):
    """Write the changes of a plan's state (s,) and torque (joints,) by errors (c,).

    From tables (k, s, t) and (k, joints, t) of terms of the errors, at a fractional row.
    """
    rows = np.empty((states.shape[1], 1 + states.shape[2]))
    write_changes(states, along, errors, rows)
    state[:] = rows[:, 0]
    write_changes(torques, along, errors, rows)
    torque[:] = rows[: torque.shape[0], 0]


@inlined
def factored(matrix, at, work):
    """Factor the rows and columns at places of a symmetric matrix, at the beginning of `work`."""
    count = len(at)
    for i in range(count):
        for j in range(count):
            work[count * i + j] = matrix[at[i], at[j]]
    return factor(work, 0, count)


@inlined
def solve_each(work, count, columns):
    """Replace each row (count,) of columns by the solution with the matrix factored in `work`."""
    after = count * count
    for c in range(columns.shape[0]):
        for i in range(count):
            work[after + i] = columns[c, i]
        solve_factored(work, 0, count, after)
        for i in range(count):
            columns[c, i] = work[after + i]


@inlined
def learn(at, work, noise, shown, missed, most, values, covariance):
    """Learn errors from what is missed (k,) of values at places, which show them by (k, c)."""
    count, size = len(at), len(values)
    across, inner = np.zeros((size, count)), np.empty((count, count))
    for i in range(size):
        for j in range(size):
            for k in range(count):
                across[i, k] += covariance[i, j] * shown[k, j]
    for k in range(count):
        for n in range(count):
            inner[k, n] = noise[at[k], at[n]]
            for j in range(size):
                inner[k, n] += shown[k, j] * across[j, n]
    if not factored(inner, np.arange(count), work):
        return
    gain = across.copy()
    solve_each(work, count, gain)
    for i in range(size):
        for k in range(count):
            values[i] += gain[i, k] * missed[k]
            for j in range(size):
                covariance[i, j] -= gain[i, k] * across[j, k]
        values[i] = min(max(values[i], -most), most)


@kernel(
    'int64(float64[:, ::1], float64[:, ::1], float64[::1], float64[:, ::1], float64[::1], '
    'int64[::1], float64, float64, boolean, float64[:, ::1], float64[::1], float64[::1], '
    'float64[:, ::1], float64[::1], float64[:, ::1], int64, float64)'
)
def learn_errors(
    measured, noise, spread, learner, innovation, at, gate, largest, learns, estimate, values,
    used, covariance, times, expected, end, since,
):  # fmt: skip
    """Correct an estimate by its innovations, and learn errors from them.

    Parameters
    ----------
    measured : (measured, e) array
    noise : (measured, measured) array
        Covariance of innovations.
    spread : (measured,) array
    learner : (e, measured) array
        Correction.
    innovation : (measured,) array
    at : (k,) int array
        Which of them are new and may correct the estimate.
    gate, largest : float
        Standard deviations (of `spread`) of an innovation beyond which nothing is learned; the
        largest error.
    learns : bool
        Whether errors may be learned.
    estimate : (e, 1 + t) array
        In place.
    values, used : (c,) arrays
        Errors, in place; those beside which the estimate is.
    covariance : (c, c) array
        Of the errors; in place.
    times, expected, end, since
        History of what is measured of the estimate, in place from a time [s] on.

    Returns
    -------
    int
        1 if nothing was learned because an innovation was too far off, else 0.
    """
    size, width = estimate.shape
    count, k = len(values), len(at)
    if k == 0:
        return 0
    rows, shown, missed = np.zeros((k, width)), np.empty((k, count)), np.empty(k)
    beside, by_values = values - used, np.empty(width)
    far = False
    for n in range(k):
        i = at[n]
        for j in range(size):
            read = measured[i, j]
            if read != 0.0:
                for c in range(width):
                    rows[n, c] += read * estimate[j, c]
        by_values[:] = rows[n]
        by_values[0] = 0.0
        move_origin(by_values, beside)
        shown[n] = by_values[1 : 1 + count]
        missed[n] = innovation[i] - by_values[0]
        far = far or abs(innovation[i]) > gate * spread[i]
    if learns and not far:
        learn(at, np.empty(k * k + k), noise, shown, missed, largest, values, covariance)
    change = np.zeros(size)
    for i in range(size):
        for n in range(k):
            gain = learner[i, at[n]]
            change[i] += gain * innovation[at[n]]
            for c in range(1, width):
                estimate[i, c] -= gain * rows[n, c]
        estimate[i, 0] += change[i]
    add_measured(measured, change, times, expected, end, since)
    return 1 if learns and far else 0


@inlined
def evidence(value, variance, likely):
    """Return twice the logarithm of how much likelier a value is of an error than of none."""
    return value * value / variance + math.log(variance / likely**2)


@inlined
def probability(none, evidence):
    """Return that of errors where none is so many times likelier before anything is measured."""
    return 1.0 / (1.0 + math.exp(math.log(none) - 0.5 * evidence))


@inlined
def believed(values, covariance, numbers, work, out):
    """Write errors (c,) by their posterior probability beside none at all.

    Of all of them together, or of each alone, if that is larger: one error that is clear is not
    doubted because of others that are none. The error RARE is first weighed against its being
    none, so that the others explain what was measured; -1: there is no such error. From LIKELY on
    are the standard deviations before anything is measured.
    """
    count, rare = len(values), int(numbers[RARE])
    none, likely = numbers[NONE], numbers[LIKELY:]
    out[:] = values
    if not factored(covariance, np.arange(count), work):
        return
    size = 0.0
    for i in range(count):
        work[count * count + i] = values[i]
        size -= math.log(work[(count + 1) * i] * likely[i] ** 2)
    solve_factored(work, 0, count, count * count)
    square = 0.0
    for i in range(count):
        square += values[i] * work[count * count + i]
    if rare >= 0:
        variance = covariance[rare, rare]
        alone = evidence(values[rare], variance + numbers[UNSURE] ** 2, likely[rare])
        doubted = values[rare] / variance * (1.0 - probability(numbers[RARELY], alone))
        for i in range(count):
            out[i] -= doubted * covariance[i, rare]
    for i in range(count):
        alone = evidence(values[i], covariance[i, i], likely[i])
        out[i] *= probability(none, max(square + size, alone))


@kernel(
    'void(float64[:, :, ::1], float64[:, :, ::1], float64[::1], float64, float64[:, ::1], '
    'float64[:, ::1], float64[:, :, ::1], float64[::1], float64[::1], float64[:, ::1], '
    'float64[:, ::1], float64[:, ::1], float64[:, :, ::1], float64[::1], float64[::1], '
    'float64[::1], float64[::1])'
)
def estimates_ahead(
    states, torques, numbers, time, transition, push, by_errors, pushes, state, seen, estimate,
    covariance, away, values, used, entering, pushed,
):  # fmt: skip
    """Bring estimates of deviations, and the errors in use, forward by a period.

    Parameters
    ----------
    states, torques : (k, s, t) and (k, joints, t) arrays
        Changes of the plan by terms of the errors.
    numbers : (NUMBERS,) array
        Step of these tables and period [s]; shares of a period in the average of `away` and in
        lags of the errors in use; growth of their variance in a period; how much likelier than
        them none is, 0 where errors count as they are estimated; which one is rare, how much
        likelier none is there, and by what deviation it may seem to be; their deviations at first.
    time : float
        Of the plan [s].
    transition, push : (e, e) and (s, p) arrays
        Of a robot without errors.
    by_errors : (t, s, s + p) array
        Changes of both by terms of the errors.
    pushes : (p,) array
        Torques on their way and the new one, beyond the plan's.
    state, seen : (e,) and (e, c) arrays
        In place: the estimate, and how far it is off by unit errors.
    estimate : (e, 1 + t) array
        The second one: in place.
    covariance : (c, c) array
        In place.
    away : (2, s + p, 1 + c) array
        In place: averages, and their averages, of deviations and torques beyond the plan of a
        robot with errors.
    values, used, entering : (c,) arrays
        Errors: as estimated; in use, and the first of the lags on the way there, both in place.
    pushed : (s,) array
        Output: what the torques do to the deviations.
    """
    size, part, count, past = state.shape[0], push.shape[0], len(used), push.shape[1]
    width, joints = estimate.shape[1], torques.shape[1]
    before, after = np.empty((part, width)), np.empty((part, width))
    held, beyond = np.empty((joints, width)), np.empty((past, width))
    write_changes(states, time / numbers[PLAN_STEP], used, before)
    write_changes(torques, time / numbers[PLAN_STEP], used, held)
    write_changes(states, (time + numbers[PERIOD]) / numbers[PLAN_STEP], used, after)
    for k in range(past):
        for j in range(width):
            beyond[k, j] = -held[k % joints, j]
        beyond[k, 0] += pushes[k]
    moves, response, changed_by = transition.copy(), np.empty(past), np.empty(part + past)
    slopes = np.empty((part, count, part + past))  # changes by further errors
    for i in range(part):
        changed_by[:] = 0.0
        for c in range(count):
            for k in range(part + past):
                slopes[i, c, k] = by_errors[c, i, k]
                changed_by[k] += used[c] * by_errors[c, i, k]
        place = count
        for a in range(count):
            for b in range(a, count):
                for k in range(part + past):
                    product = by_errors[place, i, k]
                    slopes[i, a, k] += used[b] * product
                    slopes[i, b, k] += used[a] * product
                    changed_by[k] += used[a] * used[b] * product
                place += 1
        for k in range(part):
            moves[i, k] += changed_by[k]
        for k in range(past):
            response[k] = push[i, k] + changed_by[part + k]
        pushed[i] = 0.0
        for k in range(past):
            pushed[i] += response[k] * beyond[k, 0]
            for j in range(width):
                after[i, j] += response[k] * beyond[k, j]
    share = numbers[AVERAGED]
    for j in range(1 + count):
        for i in range(part):
            away[0, i, j] += share * (estimate[i, j] - before[i, j] - away[0, i, j])
        for k in range(past):
            away[0, part + k, j] += share * (beyond[k, j] - away[0, part + k, j])
        for i in range(part + past):
            away[1, i, j] += share * (away[0, i, j] - away[1, i, j])
    changed = np.empty((count, 1 + count))
    for i in range(part):
        changed[:] = 0.0
        for c in range(count):
            for k in range(part + past):
                for j in range(1 + count):
                    changed[c, j] += slopes[i, c, k] * away[1, k, j]
        place = 1 + count
        for a in range(count):
            after[i, 1 + a] += changed[a, 0]
            for b in range(a, count):
                product = changed[a, 1 + b]
                after[i, place] += product if a == b else product + changed[b, 1 + a]
                place += 1
    # both estimates side by side, beside the plan
    columns = width + 1 + count
    now, then = np.empty((size, columns)), np.zeros((size, columns))
    for i in range(size):
        now[i, :width] = estimate[i]
        now[i, width] = state[i]
        now[i, width + 1 :] = seen[i]
        if i < part:
            now[i, :width] -= before[i]
            then[i, :width] = after[i]
            now[i, width:] -= before[i, : 1 + count]
            then[i, width:] = after[i, : 1 + count]
    for i in range(size):
        for k in range(size):
            factor_of = moves[i, k]
            if factor_of != 0.0:
                for j in range(columns):
                    then[i, j] += factor_of * now[k, j]
    for i in range(count):
        covariance[i, i] += numbers[GROWTH]
    wanted, work = values.copy(), np.empty(count * count + count)
    if numbers[NONE] > 0.0:
        believed(values, covariance, numbers, work, wanted)
    change = np.empty(count)
    for j in range(count):
        entering[j] += numbers[ENTERS] * (wanted[j] - entering[j])
        change[j] = numbers[ENTERS] * (entering[j] - used[j])
        used[j] += change[j]
    for i in range(size):
        state[i] = then[i, width]
        for j in range(count):
            seen[i, j] = then[i, width + 1 + j]
            state[i] += seen[i, j] * change[j]
        estimate[i] = then[i, :width]
        move_origin(estimate[i], change)
