"""Twists and wrenches as pairs of vectors, linear (force) first, about one common origin."""

from denoc_ros.kernels.algebra.vector import add, cross, dot, load, rotate, scale, store
from denoc_ros.kernels.jit.compiled import inlined


@inlined
def pair(a, o):
    """Return the two vectors at offset o of a."""
    return load(a, o), load(a, o + 3)


@inlined
def store_pair(a, o, x):
    """Write two vectors at offset o of a."""
    store(a, o, x[0])
    store(a, o + 3, x[1])


@inlined
def sum_pair(x, y):
    """Return x + y."""
    return add(x[0], y[0]), add(x[1], y[1])


@inlined
def scale_pair(s, x):
    """Return s x."""
    return scale(s, x[0]), scale(s, x[1])


@inlined
def dot_pair(x, y):
    """Return the power of a wrench and a twist."""
    return dot(x[0], y[0]) + dot(x[1], y[1])


@inlined
def carried(v, x):
    """Return the rate of a twist x that is carried along with the twist v."""
    return add(cross(v[1], x[0]), cross(v[0], x[1])), cross(v[1], x[1])


@inlined
def carried_wrench(v, f):
    """Return the rate of a wrench f that is carried along with the twist v."""
    return cross(v[1], f[0]), add(cross(v[1], f[1]), cross(v[0], f[0]))


@inlined
def twist_about_origin(work, o, x, linear, angular):
    """Return a body's twist in base axes: given in its axes (at o of work), of its origin x."""
    w = rotate(work, o, angular)
    return add(rotate(work, o, linear), cross(x, w)), w


@inlined
def wrench_about_origin(work, o, x, force, torque):
    """Return a wrench in base axes: given in body axes (at o of work), about its origin x."""
    f = rotate(work, o, force)
    return f, add(rotate(work, o, torque), cross(x, f))


@inlined
def strided_vector(a, o, step):
    """Return the vector whose elements stand `step` apart, from offset o of a."""
    return a[o], a[o + step], a[o + 2 * step]


@inlined
def strided(a, o, step):
    """Return the two vectors whose elements stand `step` apart, from offset o of a."""
    return strided_vector(a, o, step), strided_vector(a, o + 3 * step, step)


@inlined
def store_strided(a, o, step, x):
    """Write two vectors, their elements `step` apart, from offset o of a."""
    for k in range(3):
        a[o + step * k] = x[0][k]
        a[o + step * (3 + k)] = x[1][k]
