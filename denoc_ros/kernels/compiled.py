"""How kernels are compiled: cached, without the interpreter's lock, division by zero gives inf."""

from numba import njit

_OPTIONS = {
    'cache': True,
    'nogil': True,
    'error_model': 'numpy',
    'fastmath': {'contract', 'nsz', 'reassoc'},
}

kernel = njit(**_OPTIONS)
inlined = njit(forceinline=True, **_OPTIONS)
