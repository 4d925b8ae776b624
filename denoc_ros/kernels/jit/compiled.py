"""How kernels are compiled: cached, ahead of their first call, division by zero gives inf."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from importlib import import_module
from itertools import chain
from types import ModuleType
from typing import Any

import numba
from llvmlite.binding import Linkage, add_symbol
from numba import njit, types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler

from denoc_ros.kernels import CHECKED
from denoc_ros.kernels.jit.cache import PACKAGE, keep
from denoc_ros.kernels.jit.compiling import compile_in_turn


class OwnFunctions(JITCodeLibrary):  # type: ignore[misc]
    """Machine code that calls its own copies of the functions that were compiled into it.

    Numba leaves these copies weak: of all that have one name, a process runs the one it has loaded
    first. Another kernel's may sum in another order, so that results would depend on what was
    loaded before.
    """

    def _finalize_final_module(self) -> None:
        """Make machine code of the optimized module, whose copies are its own meanwhile."""
        weak = Linkage.linkonce_odr
        functions = self._final_module.functions
        copies = [each for each in functions if each.linkage == weak and not each.is_declaration]
        for each in copies:
            each.linkage = Linkage.internal
        super()._finalize_final_module()
        for each in copies:  # for the functions that link this module
            each.linkage = weak


class LongLoops(Compiler):  # type: ignore[misc]
    """Compiles as numba does, with vectorized loops.

    Numba has one setting for all functions, which it reads as it compiles each, under its lock.
    """

    vectorizes = numba.config.LOOP_VECTORIZE

    def compile_extra(self, func: Callable[..., Any]) -> Any:
        """Compile a function; those that it calls come in between, with their own setting."""
        before = numba.config.LOOP_VECTORIZE
        numba.config.LOOP_VECTORIZE = self.vectorizes
        self.state.library = OwnFunctions(self.state.targetctx.codegen(), func.__qualname__)
        self.state.library.enable_object_caching()
        try:
            return super().compile_extra(func)
        finally:
            numba.config.LOOP_VECTORIZE = before


class ShortLoops(LongLoops):
    """Compiles without vectorizing loops, for those that go over a handful of modes or axes.

    Vectorized, these spend more on finding out that they are short than on their work.
    """

    vectorizes = 0


_OPTIONS = {
    'boundscheck': CHECKED or None,
    'error_model': 'numpy',
    'fastmath': {'contract', 'nsz', 'reassoc'},
    # unless it is said, numba takes it from whatever function happens to call this one first
    'forceinline': False,
    'pipeline_class': LongLoops,
}
_SHORT_OPTIONS = {**_OPTIONS, 'pipeline_class': ShortLoops}
# every kernel that Python calls, and the one signature it is compiled for
DECLARED: dict[Any, Any] = {}
# every function that kernels call by its symbol
APART: dict[str, Any] = {}
NUMBERS = types.CPointer(types.float64)


def _njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return numba's decorator with options, for functions that are kept once compiled."""
    compiler = njit(**options)
    return lambda function: keep(compiler(function))


# checks within one large function would take the compiler minutes
_INLINED = {'forceinline': not CHECKED}
inlined = _njit(**_OPTIONS | _INLINED)
# the same for loops over a handful of modes or axes
short_inlined = _njit(**_SHORT_OPTIONS | _INLINED)
# its sums are done in the order in which they are written
ordered = _njit(**_OPTIONS | _INLINED | {'fastmath': {'contract', 'nsz'}})
# the whole of an algorithm, which more than one kernel calls
shared = _njit(**_OPTIONS)
short_shared = _njit(**_SHORT_OPTIONS)
# the same, compiled within each kernel that calls it: by itself it would be compiled once more
merged = shared if CHECKED else _njit(inline='always', **_OPTIONS)


def kernel(signature: Any) -> Callable[[Callable[..., Any]], Any]:
    """Declare a function that Python calls with arguments of just these types.

    It keeps the interpreter's lock: giving it up and taking it back would cost a control loop more
    than a call takes.
    """
    return _declared(signature, _njit(**_OPTIONS))


def rows_kernel(signature: Any) -> Callable[[Callable[..., Any]], Any]:
    """Declare a function over many states, which lets other threads run meanwhile."""
    return _declared(signature, _njit(nogil=True, **_OPTIONS))


def apart(signature: Any, short_loops: bool = False) -> Callable[[Callable[..., Any]], Any]:
    """Declare the whole of an algorithm, compiled once for all kernels: they call its symbol.

    What is `shared` or `merged` is compiled again within each kernel that calls it, which takes
    seconds for the largest. Arguments are numbers and pointers; it calls no other one apart.
    """

    def declare(function: Callable[..., Any]) -> Any:
        dispatcher = _njit(**_SHORT_OPTIONS if short_loops else _OPTIONS)(function)
        if CHECKED:  # its pointers know the numbers of their elements, and its errors are raised
            return dispatcher
        DECLARED[dispatcher] = signature
        symbol = f'{function.__module__}.{function.__qualname__}'
        APART[symbol] = dispatcher
        return types.ExternalFunction(symbol, signature)

    return declare


def _declared(signature: Any, compiler: Any) -> Callable[[Callable[..., Any]], Any]:
    def declare(function: Callable[..., Any]) -> Any:
        dispatcher = compiler(function)
        DECLARED[dispatcher] = signature
        return dispatcher

    return declare


def kernel_modules() -> list[ModuleType]:
    """Import all modules of kernels, those of optional parts too, and return them."""
    files = sorted(PACKAGE.glob('**/kernels/*/*.py')) + sorted(PACKAGE.glob('*/kernels/*.py'))
    names = ('.'.join(file.relative_to(PACKAGE.parent).with_suffix('').parts) for file in files)
    return [import_module(name) for name in names if not name.endswith('.__init__')]


def ready(*kernels: Any) -> None:
    """Compile kernels, or load them from the cache, and let no other signature be compiled.

    A call with other types then raises TypeError. What has to be compiled is announced to the log,
    for it takes a while.
    """
    missing = {kernel: _symbols(kernel) for kernel in kernels if not kernel.overloads}
    symbols = sorted(set().union(*missing.values()))
    by_itself = [kernel for kernel, called in missing.items() if not called]
    # algorithms call the same functions: another process would compile these once more
    algorithms = [APART[symbol] for symbol in symbols if not APART[symbol].signatures]
    _compile([algorithms, *([kernel] for kernel in by_itself)])
    for symbol in symbols:  # a kernel is linked as it is loaded
        add_symbol(symbol, _address(APART[symbol]))
    _compile([[kernel] for kernel, called in missing.items() if called])


def _compile(groups: Sequence[Sequence[Any]]) -> None:
    """Compile for the one signature that is declared, or load."""
    compile_in_turn([[(each, DECLARED[each]) for each in group] for group in groups])
    for dispatcher in chain(*groups):
        dispatcher.disable_compile()


def _address(dispatcher: Any) -> int:
    """Return where the code of a function stands that is called as C calls functions."""
    (compiled,) = dispatcher.overloads.values()
    name = compiled.fndesc.llvm_cfunc_wrapper_name
    return int(compiled.library.get_pointer_to_function(name))


def _symbols(dispatcher: Any) -> set[str]:
    """Return the symbols that a kernel and all that is compiled within it call."""
    found: set[str] = set()
    seen, todo = set(), [dispatcher]
    while todo:
        function = todo.pop().py_func
        if function in seen:
            continue
        seen.add(function)
        cells = [cell.cell_contents for cell in function.__closure__ or ()]
        for called in (*map(function.__globals__.get, function.__code__.co_names), *cells):
            if isinstance(called, types.ExternalFunction):
                found.add(called.symbol)
            elif hasattr(called, 'py_func'):
                todo.append(called)
    return found


@cache
def entry(dispatcher: Any) -> Callable[..., int]:
    """Return the compiled function of a kernel, which takes types on trust; compile it if need be.

    The dispatcher before it looks at the type of every argument. Only for kernels whose arguments
    are numbers, and arrays whose types are known or that they look into by themselves.
    """
    if not dispatcher.overloads:
        ready(dispatcher)
    (compiled,) = dispatcher.overloads.values()
    function: Callable[..., int] = compiled.entry_point
    return function
