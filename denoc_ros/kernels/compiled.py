"""How kernels are compiled: cached, ahead of their first call, division by zero gives inf."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba import njit

LOG = logging.getLogger('denoc_ros')

_OPTIONS = {
    'cache': True,
    'error_model': 'numpy',
    'fastmath': {'contract', 'nsz', 'reassoc'},
}
# every kernel that Python calls, and the one signature it is compiled for
DECLARED: dict[Any, Any] = {}

inlined = njit(forceinline=True, **_OPTIONS)
# its sums are done in the order in which they are written
ordered = njit(forceinline=True, **{**_OPTIONS, 'fastmath': {'contract', 'nsz'}})
# the whole of an algorithm, which more than one kernel calls
shared = njit(**_OPTIONS)


def kernel(signature: Any) -> Callable[[Callable[..., Any]], Any]:
    """Declare a function that Python calls with arguments of just these types.

    It keeps the interpreter's lock: giving it up and taking it back would cost a control loop more
    than a call takes.
    """
    return _declared(signature, njit(**_OPTIONS))


def rows_kernel(signature: str) -> Callable[[Callable[..., Any]], Any]:
    """Declare a function over many states, which lets other threads run meanwhile."""
    return _declared(signature, njit(nogil=True, **_OPTIONS))


def _declared(signature: Any, compiler: Any) -> Callable[[Callable[..., Any]], Any]:
    def declare(function: Callable[..., Any]) -> Any:
        dispatcher = compiler(function)
        DECLARED[dispatcher] = signature
        return dispatcher

    return declare


def ready(*kernels: Any) -> None:
    """Compile kernels, or load them from the cache, and let no other signature be compiled.

    A call with other types then raises TypeError. The first time on a machine is announced to the
    log, for it takes a while.
    """
    missing = [dispatcher for dispatcher in kernels if not dispatcher.signatures]
    if missing and not any(Path(numba.config.CACHE_DIR).rglob('*.nbi')):
        LOG.info('compiling kernels, once per machine: about half a minute')
    for dispatcher in missing:
        dispatcher.compile(DECLARED[dispatcher])
        dispatcher.disable_compile()


def entry(dispatcher: Any) -> Callable[..., int]:
    """Return the compiled function of a kernel that is ready, which takes types on trust.

    The dispatcher before it looks at the type of every argument. Only for kernels whose arguments
    are an address and arrays that they look into by themselves.
    """
    (compiled,) = dispatcher.overloads.values()
    function: Callable[..., int] = compiled.entry_point
    return function
