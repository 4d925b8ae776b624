"""The acceleration that a body inherits from the free coordinates before it."""

from denoc_ros.kernels.compiled import inlined
from denoc_ros.kernels.handle import at
from denoc_ros.kernels.layout import (
    ARM,
    COLUMNS,
    COORDINATE,
    FREE_ACCELERATION,
    JOINT,
    MODES,
    PARENT,
    SECTION,
    SECTION_POSITION,
    SECTION_WORK,
    WORK,
)
from denoc_ros.kernels.vector import add, cross, load, scale, unrotate


@inlined
def carried_change(topology, work, qdd, i):
    """Return the acceleration that row i inherits from free coordinates before its joint."""
    p = at(topology, i, PARENT)
    o = at(topology, i, WORK)
    u = at(topology, p, WORK)
    a = load(work, u + FREE_ACCELERATION)
    al = load(work, u + FREE_ACCELERATION + 3)
    if at(topology, i, SECTION) > 0:
        s = at(topology, i, SECTION_WORK)
        a = add(a, cross(al, load(work, s + SECTION_POSITION)))
        c = s + COLUMNS
        j = at(topology, p, COORDINATE) + at(topology, p, JOINT)
        for n in range(j, j + at(topology, p, MODES)):
            a = add(a, scale(qdd[n], load(work, c)))
            al = add(al, scale(qdd[n], load(work, c + 3)))
            c += 6
    a = add(a, cross(al, load(work, o + ARM)))
    return unrotate(work, o, a), unrotate(work, o, al)
