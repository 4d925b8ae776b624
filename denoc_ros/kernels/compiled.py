"""How kernels are compiled: cached, ahead of their first call, division by zero gives inf."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit

from denoc_ros.kernels import CHECKED
from denoc_ros.kernels.cache import keep_by_name
from denoc_ros.kernels.compiling import compile_in_turn

keep_by_name()

_OPTIONS = {
    'boundscheck': CHECKED or None,
    'cache': True,
    'error_model': 'numpy',
    'fastmath': {'contract', 'nsz', 'reassoc'},
}
# every kernel that Python calls, and the one signature it is compiled for
DECLARED: dict[Any, Any] = {}

# checks within one large function would take the compiler minutes
inlined = njit(forceinline=not CHECKED, **_OPTIONS)
# its sums are done in the order in which they are written
ordered = njit(forceinline=not CHECKED, **{**_OPTIONS, 'fastmath': {'contract', 'nsz'}})
# the whole of an algorithm, which more than one kernel calls
shared = njit(**_OPTIONS)
# the same, compiled within each kernel that calls it: by itself it would be compiled once more
merged = shared if CHECKED else njit(inline='always', **_OPTIONS)


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

    A call with other types then raises TypeError. What has to be compiled is announced to the log,
    for it takes a while.
    """
    missing = [dispatcher for dispatcher in kernels if not dispatcher.signatures]
    compile_in_turn([(dispatcher, DECLARED[dispatcher]) for dispatcher in missing])
    for dispatcher in missing:
        dispatcher.disable_compile()


def entry(dispatcher: Any) -> Callable[..., int]:
    """Return the compiled function of a kernel that is ready, which takes types on trust.

    The dispatcher before it looks at the type of every argument. Only for kernels whose arguments
    are an address and arrays that they look into by themselves.
    """
    (compiled,) = dispatcher.overloads.values()
    function: Callable[..., int] = compiled.entry_point
    return function
