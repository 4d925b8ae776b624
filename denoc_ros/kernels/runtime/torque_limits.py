"""Limits of torque and of its change."""

import numpy as np

from denoc_ros.kernels.jit.compiled import kernel


@kernel('boolean(float64[::1], float64[::1], float64, float64, float64[::1], int64[::1])')
def limit_torque(torque, limits, most_change, largest, last, clamped):
    """Write a torque (n,), within its limits and change, into `last`; count clamped ones.

    Parameters
    ----------
    torque, limits : (n,) arrays
        Wanted, and largest magnitudes [N m or N].
    most_change : float
        Largest difference from `last`.
    largest : float
        Magnitude of no robot: a torque with more, or with a NaN, counts as `last`.
    last : (n,) array
        What left last; output.
    clamped : (n,) array
        Output: 1 is added where something else leaves than was wanted.

    Returns
    -------
    bool
        Whether the torque was one.
    """
    good = True
    for k in range(torque.shape[0]):
        if not abs(torque[k]) <= largest:
            good = False
    for k in range(torque.shape[0]):
        wanted = torque[k] if good else last[k]
        new = max(min(wanted, limits[k]), -limits[k])
        if most_change < np.inf:
            new = min(max(new, last[k] - most_change), last[k] + most_change)
        if new != wanted:
            clamped[k] += 1
        last[k] = new
    return good


@kernel('void(float64[::1], float64[::1], float64[::1], int64[::1], float64[::1])')
def saturate(wanted, limits, effort, places, tau):
    """Write efforts (n,) within their limits, also to their places in generalized forces.

    Parameters
    ----------
    wanted, limits : (n,) arrays
        Efforts, and their largest magnitudes [N m or N].
    effort : (n,) array
        Output; may be `wanted`.
    places : (n,) array of int64
        Coordinates of the drives.
    tau : (coordinates,) array
        Output.
    """
    for k in range(wanted.shape[0]):
        value = wanted[k]  # a NaN stays one
        if value > limits[k]:
            value = limits[k]
        elif value < -limits[k]:
            value = -limits[k]
        effort[k] = tau[places[k]] = value
