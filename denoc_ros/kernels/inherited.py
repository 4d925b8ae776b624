"""The acceleration that a body inherits from the free coordinates before it."""

from denoc_ros.kernels import layout as at_
from denoc_ros.kernels.compiled import inlined
from denoc_ros.kernels.handle import at
from denoc_ros.kernels.vector import add, cross, load, scale, unrotate


@inlined
def carried_change(topology, work, qdd, i):
    """Return the acceleration that row i inherits from free coordinates before its joint."""
    p = at(topology, i, at_.PARENT)
    o = at(topology, i, at_.WORK)
    u = at(topology, p, at_.WORK)
    a = load(work, u + at_.FREE_ACCELERATION)
    al = load(work, u + at_.FREE_ACCELERATION + 3)
    if at(topology, i, at_.SECTION) > 0:
        s = at(topology, i, at_.SECTION_WORK)
        a = add(a, cross(al, load(work, s + at_.SECTION_POSITION)))
        c = s + at_.COLUMNS
        j = at(topology, p, at_.COORDINATE) + at(topology, p, at_.JOINT)
        for n in range(j, j + at(topology, p, at_.MODES)):
            a = add(a, scale(qdd[n], load(work, c)))
            al = add(al, scale(qdd[n], load(work, c + 3)))
            c += 6
    a = add(a, cross(al, load(work, o + at_.ARM)))
    return unrotate(work, o, a), unrotate(work, o, al)
