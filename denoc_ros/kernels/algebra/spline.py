"""Motions along splines of fifth order."""

from denoc_ros.kernels.jit.compiled import kernel


@kernel('void(float64[::1], float64[:, :, ::1], float64, float64[::1])')
def sample_quintics(times, pieces, t, out):
    """Write the values (m,) of a piecewise polynomial at a time.

    Parameters
    ----------
    times : (k,) array
        Of the knots, increasing.
    pieces : (k - 1, 6, m) array
        Coefficients by the powers of the time since a piece's first knot.
    t : float
        Beyond the knots the first or last piece goes on.
    """
    low, high = 0, times.shape[0] - 2
    while low < high:
        middle = (low + high + 1) // 2
        if times[middle] <= t:
            low = middle
        else:
            high = middle - 1
    s = t - times[low]
    for j in range(out.shape[0]):
        value = pieces[low, 5, j]
        for power in range(4, -1, -1):
            value = value * s + pieces[low, power, j]
        out[j] = value
