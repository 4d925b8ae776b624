"""Floating-point operations of the kernels, counted while their own source executes.

The kernels' Python source runs on numbers that count what is done to them. Nothing is estimated:
what a loop skips is not counted and what it does with a zero is. The compiler may still fold
constants and merge common terms, so this is what is asked of the machine, not what it does.
"""

from __future__ import annotations

import math
import operator
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import CellType, FunctionType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.robot import Robot
from denoc_ros.kernels.jit.compiled import APART, inlined, kernel, kernel_modules, ready
from denoc_ros.kernels.jit.handle import DIAGONALS, GOOD
from denoc_ros.types import Array

VECTORS = 'denoc_ros.kernels.algebra.vector'

Objects = NDArray[np.object_]


@dataclass
class Operations:
    """How many operations were executed."""

    multiplications: int = 0
    additions: int = 0  # and subtractions
    divisions: int = 0
    roots: int = 0
    trigonometric: int = 0  # sine, cosine, hyperbolic tangent

    def __add__(self, other: Operations) -> Operations:
        """Return the sums."""
        return Operations(*(a + b for a, b in zip(self.parts, other.parts, strict=True)))

    @property
    def parts(self) -> tuple[int, int, int, int, int]:
        """The five counts in order."""
        return (
            self.multiplications,
            self.additions,
            self.divisions,
            self.roots,
            self.trigonometric,
        )


def counting(part: str, function: Callable[..., float]) -> Callable[..., Counted]:
    """Return the method of an operation that counts as one of a part of `Operations`."""

    def method(self: Counted, *others: Counted | float) -> Counted:
        setattr(self.tally, part, getattr(self.tally, part) + 1)
        return Counted(function(self.value, *map(float, others)), self.tally)

    return method


def comparing(function: Callable[[float, float], bool]) -> Callable[..., bool]:
    """Return the method of a comparison, which is free."""
    return lambda self, other: function(self.value, float(other))


class Counted:
    """A number that counts its operations; change of sign and comparison are free."""

    __slots__ = ('tally', 'value')

    def __init__(self, value: float, tally: Operations) -> None:
        self.value = value
        self.tally = tally

    def __float__(self) -> float:
        return self.value

    def __neg__(self) -> Counted:
        return Counted(-self.value, self.tally)

    def __abs__(self) -> Counted:
        return Counted(abs(self.value), self.tally)

    def __pow__(self, power: int) -> Counted:
        self.tally.multiplications += power - 1
        return Counted(self.value**power, self.tally)

    __add__ = __radd__ = counting('additions', operator.add)
    __sub__ = counting('additions', operator.sub)
    __rsub__ = counting('additions', lambda a, b: b - a)
    __mul__ = __rmul__ = counting('multiplications', operator.mul)
    __truediv__ = counting('divisions', operator.truediv)
    __rtruediv__ = counting('divisions', lambda a, b: b / a)
    __eq__ = comparing(operator.eq)  # type: ignore[assignment]
    __hash__ = None  # type: ignore[assignment]
    __lt__ = comparing(operator.lt)
    __le__ = comparing(operator.le)
    __gt__ = comparing(operator.gt)
    __ge__ = comparing(operator.ge)
    # numpy's functions of one number look for methods of these names; whole numbers are an
    # addition's work
    rint = counting('additions', lambda a: float(round(a)))
    floor = counting('additions', lambda a: float(math.floor(a)))
    sin = counting('trigonometric', math.sin)
    cos = counting('trigonometric', math.cos)
    tanh = counting('trigonometric', math.tanh)
    sqrt = counting('roots', math.sqrt)


class CountingKernels:
    """The kernels' source as plain Python functions over one robot's arrays.

    Attributes
    ----------
    shares : dict of str to int
        Multiplications and additions of the last call by the kernel that does them itself, its
        products of vectors included.
    """

    def __init__(self, robot: Robot) -> None:
        self.tally = Operations()
        self.shares: dict[str, int] = {}
        self._running: list[int] = []  # operations of what the running kernels have called
        self._model = self._arrays(robot)
        instead: dict[str, Callable[..., Any]] = {
            'model_arrays': lambda handle: self._model,
            'coordinates': lambda handle: robot.n,
            'link_side': lambda handle: handle,
            'beyond': lambda array, count: array[count:],
            # a check of the result, no part of the algorithm
            'all_finite': lambda values, count: True,
        }
        self._spaces = _plain_kernels(instead, self._attributed)

    def count(self, module: str, function: str, *arguments: Any) -> tuple[Operations, Array]:
        """Operations of one call, and the values of its last argument after it.

        Parameters
        ----------
        module, function : str
            Where the kernel is, below `denoc_ros.kernels`, and its name.
        arguments : what follows the handle; arrays are copied, flattened and counted.
        """
        counted = [self.counted(a).ravel() if isinstance(a, np.ndarray) else a for a in arguments]
        self.tally.__init__()  # type: ignore[misc]
        self.shares.clear()
        kernel = self._spaces[f'denoc_ros.kernels.{module}'][function]
        status = kernel(0, *counted)
        if status != GOOD:
            raise ValueError(f'{function} must succeed to be counted, got status {status}')
        found = Operations(*self.tally.parts)
        return found, np.reshape(counted[-1].astype(np.float64), np.shape(arguments[-1]))

    def function(self, module: str, name: str) -> Callable[..., Any]:
        """Return a kernel's piece as a plain function, for numbers made by :meth:`counted`."""
        function: Callable[..., Any] = self._spaces[f'denoc_ros.kernels.{module}'][name]
        return function

    def _attributed(self, function: FunctionType) -> Callable[..., Any]:
        name, tally, running = function.__name__, self.tally, self._running

        def attributed(*arguments: Any) -> Any:
            before = tally.multiplications + tally.additions
            running.append(0)
            result = function(*arguments)
            total = tally.multiplications + tally.additions - before
            own = total - running.pop()
            if own:
                self.shares[name] = self.shares.get(name, 0) + own
            if running:
                running[-1] += total
            return result

        return attributed

    def counted(self, values: Array) -> Objects:
        """Return an array of the same shape whose numbers count."""
        out = np.empty(values.shape, dtype=object)
        for index, value in np.ndenumerate(values):
            out[index] = Counted(float(value), self.tally)
        return out

    def _arrays(self, robot: Robot) -> tuple[Any, ...]:
        """Counting arrays in place of those of `model_arrays`, flat where that has pointers."""
        arrays = robot.arrays
        diagonals = np.zeros((DIAGONALS, arrays.n))
        diagonals[: len(arrays.diagonals)] = arrays.diagonals
        return (
            arrays.topology.ravel(),
            self.counted(robot.constants),
            self.counted(robot.work),
            self.counted(diagonals),
            arrays.bodies,
        )


def _plain_kernels(
    instead: dict[str, Callable[..., Any]], attributed: Callable[[FunctionType], Any]
) -> dict[str, dict[str, Any]]:
    """Return the kernels' modules as namespaces of plain functions that see each other.

    Parameters
    ----------
    instead : {name: callable}
        What stands for functions that deal with memory.
    attributed : callable
        Wraps every function but products of vectors.
    """
    spaces = {module.__name__: dict(vars(module)) for module in kernel_modules()}
    for space in spaces.values():
        for name, value in space.items():
            source = _source(value)
            if source is not None:
                moved = _moved(source, spaces)
                space[name] = moved if source.__module__ == VECTORS else attributed(moved)
        space.update({name: function for name, function in instead.items() if name in space})
    return spaces


def _source(value: Any) -> FunctionType | None:
    """Return the Python function of a compiled one, by its symbol too; None for other values."""
    apart = APART.get(getattr(value, 'symbol', ''), value)
    source: FunctionType | None = getattr(apart, 'py_func', None)
    return source


def _moved(source: FunctionType, spaces: dict[str, dict[str, Any]]) -> FunctionType:
    """Return a function with the same code that looks its names up in the plain namespaces."""
    space = spaces[source.__globals__['__name__']]
    closure = tuple(
        CellType(_plain(cell.cell_contents, spaces)) for cell in source.__closure__ or ()
    )
    moved = FunctionType(source.__code__, space, source.__name__, source.__defaults__, closure)
    moved.__kwdefaults__ = source.__kwdefaults__
    return moved


def _plain(value: Any, spaces: dict[str, dict[str, Any]]) -> Any:
    """Return a compiled function's plain counterpart, looked up when called; or the value."""
    source = _source(value)
    if source is None:
        return value
    return lambda *arguments: spaces[source.__module__][source.__name__](*arguments)


TURNS = 4_000  # of a loop per measurement: short enough to run undisturbed now and then
CHAINS = 8  # independent numbers in a loop, enough to fill the pipelines
REPEATS = 300


def eight(step: Callable[[float, float, float], float]) -> Any:
    """Return a kernel that does a step of x, a and b in turn on eight independent numbers x."""
    inner = inlined(step)

    @kernel('float64(int64, float64, float64)')
    def turn(turns: int, a: float, b: float) -> float:
        s, t, u, v = b, 2.0 * b, 3.0 * b, 4.0 * b
        w, x, y, z = 5.0 * b, 6.0 * b, 7.0 * b, 8.0 * b
        for _ in range(turns):
            s, t, u, v = inner(s, a, b), inner(t, a, b), inner(u, a, b), inner(v, a, b)
            w, x, y, z = inner(w, a, b), inner(x, a, b), inner(y, a, b), inner(z, a, b)
        return s + t + u + v + w + x + y + z

    return turn


fused = eight(lambda x, a, b: x * a + b)
divided = eight(lambda x, a, b: a / x)
rooted = eight(lambda x, a, b: np.sqrt(x))


@kernel('float64(int64, float64, float64)')
def turned(turns: int, a: float, b: float) -> float:
    """Take sine and cosine of eight angles."""
    total = 0.0
    for k in range(turns):
        for n in range(4):
            x = a * k + b * n
            total += np.sin(x) + np.cos(x)
    return total


@dataclass(frozen=True)
class Machine:
    """Times per operation of one core, nothing waiting for anything [s]."""

    fused: float  # a scalar multiplication with its addition
    division: float
    root: float
    trigonometric: float


def measure_machine() -> Machine:
    """Return the shortest times that were seen."""
    ready(fused, divided, rooted, turned)
    return Machine(*(_shortest(loop) for loop in (fused, divided, rooted, turned)))


def _shortest(loop: Any) -> float:
    clock = time.perf_counter
    took = []
    for _ in range(REPEATS):
        start = clock()
        loop(TURNS, 0.999, 0.001)
        took.append(clock() - start)
    return min(took) / (TURNS * CHAINS)
