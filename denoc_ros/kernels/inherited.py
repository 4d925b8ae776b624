"""The acceleration that a body inherits from the free coordinates before it."""

from denoc_ros.kernels.compiled import inlined
from denoc_ros.kernels.handle import at
from denoc_ros.kernels.layout import (
    ARM,
    CHANGE,
    COLUMNS,
    COORDINATE,
    JOINT,
    MODES,
    PARENT,
    PLACE,
    SECTION,
    SECTION_WORK,
    WORK,
)
from denoc_ros.kernels.vector import add, cross, load, scale, unrotate


@inlined
def carried_change(ints, work, qdd, i):
    """Return the acceleration that row i inherits from free coordinates before its joint."""
    p = at(ints, i, PARENT)
    o = at(ints, i, WORK)
    u = at(ints, p, WORK)
    a = load(work, u + CHANGE)
    al = load(work, u + CHANGE + 3)
    if at(ints, i, SECTION) > 0:
        s = at(ints, i, SECTION_WORK)
        a = add(a, cross(al, load(work, s + PLACE)))
        c = s + COLUMNS
        j = at(ints, p, COORDINATE) + at(ints, p, JOINT)
        for n in range(j, j + at(ints, p, MODES)):
            a = add(a, scale(qdd[n], load(work, c)))
            al = add(al, scale(qdd[n], load(work, c + 3)))
            c += 6
    a = add(a, cross(al, load(work, o + ARM)))
    return unrotate(work, o, a), unrotate(work, o, al)
