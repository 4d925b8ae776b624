"""Three-vectors as tuples, which the compiler keeps in registers."""

from denoc_ros.kernels.jit.compiled import inlined


@inlined
def load(a, o):
    """Return the vector at offset o of a."""
    return a[o], a[o + 1], a[o + 2]


@inlined
def store(a, o, v):
    """Write v at offset o of a."""
    a[o] = v[0]
    a[o + 1] = v[1]
    a[o + 2] = v[2]


@inlined
def accumulate(a, o, v):
    """Add v to the vector at offset o of a."""
    a[o] += v[0]
    a[o + 1] += v[1]
    a[o + 2] += v[2]


@inlined
def add(u, v):
    """Return u + v."""
    return u[0] + v[0], u[1] + v[1], u[2] + v[2]


@inlined
def subtract(u, v):
    """Return u - v."""
    return u[0] - v[0], u[1] - v[1], u[2] - v[2]


@inlined
def scale(s, v):
    """Return s v."""
    return s * v[0], s * v[1], s * v[2]


@inlined
def dot(u, v):
    """Return u . v."""
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@inlined
def cross(u, v):
    """Return u x v."""
    return (
        u[1] * v[2] - u[2] * v[1],
        u[2] * v[0] - u[0] * v[2],
        u[0] * v[1] - u[1] * v[0],
    )


@inlined
def rotate(a, o, v):
    """Return R v, R row-major at offset o of a."""
    return (
        a[o] * v[0] + a[o + 1] * v[1] + a[o + 2] * v[2],
        a[o + 3] * v[0] + a[o + 4] * v[1] + a[o + 5] * v[2],
        a[o + 6] * v[0] + a[o + 7] * v[1] + a[o + 8] * v[2],
    )


@inlined
def unrotate(a, o, v):
    """Return R^T v, R row-major at offset o of a."""
    return (
        a[o] * v[0] + a[o + 3] * v[1] + a[o + 6] * v[2],
        a[o + 1] * v[0] + a[o + 4] * v[1] + a[o + 7] * v[2],
        a[o + 2] * v[0] + a[o + 5] * v[1] + a[o + 8] * v[2],
    )


@inlined
def times(s, v):
    """Return S v, S symmetric as xx xy xz yy yz zz."""
    return (
        s[0] * v[0] + s[1] * v[1] + s[2] * v[2],
        s[1] * v[0] + s[3] * v[1] + s[4] * v[2],
        s[2] * v[0] + s[4] * v[1] + s[5] * v[2],
    )


@inlined
def symmetric(a, o, v):
    """Return S v, S symmetric at offset o of a as xx xy xz yy yz zz."""
    return times((a[o], a[o + 1], a[o + 2], a[o + 3], a[o + 4], a[o + 5]), v)


@inlined
def turned(s, x, y, z):
    """Return R S R^T, S and the result symmetric as xx xy xz yy yz zz; R has the rows x, y, z."""
    u, v, w = times(s, x), times(s, y), times(s, z)
    return dot(x, u), dot(x, v), dot(x, w), dot(y, v), dot(y, w), dot(z, w)


@inlined
def all_finite(a, n):
    """Say whether all n elements of a are finite (inf - inf and 0 * inf are not a number)."""
    s = 0.0
    for k in range(n):
        s += a[k] * 0.0
    return s == 0.0
