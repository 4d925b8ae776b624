"""Linear models of a robot about a state: poles, zeros, frequency responses, sampled models."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from denoc_ros.errors import DenocError, StateError
from denoc_ros.types import Array

if TYPE_CHECKING:
    from control import StateSpace

Complex = NDArray[np.complex128]

STILL_SHARE = 1e-6  # of the fastest mode: scale [rad/s] of motions that have no frequency
ROUNDING = 1e-10  # of the largest pole
DOUBLE_ROUNDING = 1e-7  # of the largest zero: double ones at 0 are off by the root of rounding
NO_EFFECT = 1e-10  # of the sizes of its factors: a product that is rounding
SLACK = 1e-9  # of a period: a delay this close to a multiple of it is one


@dataclass(frozen=True)
class Signals:
    """Signals of x' = a x + b u, y = c x + d u; names and arrays in one order."""

    a: Array
    b: Array
    c: Array
    d: Array
    state_names: tuple[str, ...]
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]

    def _place(self, name: str | int, kind: str) -> int:
        names: tuple[str, ...] = getattr(self, f'{kind}_names')
        if isinstance(name, int) and -len(names) <= name < len(names):
            return name
        if name not in names:
            raise StateError(f'{kind} must be one of {", ".join(names)}, got {name!r}')
        return names.index(str(name))

    def _to_control(self, period: float) -> StateSpace:
        try:
            import control
        except ImportError as error:
            raise DenocError(
                'python-control must be installed for to_control: pip install denoc_ros[control]'
            ) from error
        return control.ss(
            self.a, self.b, self.c, self.d, period,
            states=list(self.state_names), inputs=list(self.input_names),
            outputs=list(self.output_names),
        )  # fmt: skip


@dataclass(frozen=True)
class DiscreteModel(Signals):
    """A linear model sampled with its inputs held: x[k + 1] = a x[k] + b u[k].

    Attributes
    ----------
    a, b, c, d : arrays
    state_names, input_names, output_names : tuple of str
        Past inputs that are still on their way are states `<input>[-1]`, `[-2]`, ...
    period, delay : float [s]
    """

    period: float
    delay: float

    def poles(self) -> Complex:
        """Return the eigenvalues of a; stable within the unit circle."""
        return np.asarray(scipy.linalg.eigvals(self.a), dtype=np.complex128)

    def to_control(self) -> StateSpace:
        """Return python-control's StateSpace with this period."""
        return self._to_control(self.period)


@dataclass(frozen=True)
class LinearModel(Signals):
    """x' = a x + b u, y = c x + d u: small changes about a state of a robot.

    Attributes
    ----------
    a, b, c, d : arrays (s, s), (s, inputs), (outputs, s), (outputs, inputs)
        x = [y; y'] with minimal coordinates y.
    state_names, input_names, output_names : tuple of str
        Units are SI; `<coordinate>_rate` are time derivatives.
    q, qd, tau, qdd : (n,) arrays
        The state it is about, all coordinates of the robot: forces that act there and the
        accelerations they leave. `qdd` is zero at an equilibrium; where it is not, the model is
        of small changes about the motion through that state.
    inertia : (s / 2, s / 2) array
        Of the minimal coordinates.
    multipliers : (rows,) array
        Of loops and mimic joints at that state.
    """

    q: Array
    qd: Array
    tau: Array
    qdd: Array
    inertia: Array
    multipliers: Array = field(default_factory=lambda: np.zeros(0))

    def _scaled(self) -> tuple[Array, Array, Array]:
        """Return a, b and c in modal states (omega eta, eta'), in which eigenvalues are exact.

        Without damping and gyroscopic terms a is then skew-symmetric.
        """
        m = len(self.inertia)
        lower = scipy.linalg.cholesky(self.inertia, lower=True)
        stiffness = -self.inertia @ self.a[m:, :m]
        half = scipy.linalg.solve_triangular(lower, 0.5 * (stiffness + stiffness.T), lower=True)
        square = scipy.linalg.solve_triangular(lower, half.T, lower=True)
        squares, modes = np.linalg.eigh(0.5 * (square + square.T))
        omega = np.sqrt(np.abs(squares))
        omega = np.maximum(omega, STILL_SHARE * (omega.max(initial=0.0) or 1.0))
        shapes = scipy.linalg.solve_triangular(lower, modes, lower=True, trans='T')
        inverse = modes.T @ lower.T
        a = np.zeros_like(self.a)
        a[:m, m:] = np.diag(omega)
        a[m:, :m] = inverse @ (self.a[m:, :m] @ shapes) / omega
        a[m:, m:] = inverse @ self.a[m:, m:] @ shapes
        b = np.concatenate([np.zeros_like(self.b[:m]), inverse @ self.b[m:]])
        c = np.concatenate([self.c[:, :m] @ shapes / omega, self.c[:, m:] @ shapes], axis=1)
        return a, b, c

    def poles(self) -> Complex:
        """Return the poles [rad/s], by rising size.

        At rest they are those of the natural modes, -zeta omega +- i omega sqrt(1 - zeta^2).
        """
        return _sorted(scipy.linalg.eigvals(self._scaled()[0]))

    def zeros(self, input: str | int, output: str | int) -> Complex:
        """Return the zeros [rad/s] of one input's way to one output, by rising size.

        A zero with a positive real part is non-minimum phase: the output first moves the wrong
        way, and no fast loop about it is stable.

        Notes
        -----
        The output is differentiated until the input acts on it at once; what motion is left
        while it stands still has these poles.
        """
        a, b, c = self._scaled()
        j, i = self._place(input, 'input'), self._place(output, 'output')
        column, row, direct = b[:, j], c[i], float(self.d[i, j])
        least = NO_EFFECT * float(np.abs(self.d[i]).max())
        rows: list[Array] = []
        while abs(direct) <= least:
            if len(rows) == len(a) or not row.any():
                return np.zeros(0, dtype=np.complex128)  # the input does not reach the output
            rows.append(row / np.linalg.norm(row))
            direct, row = float(rows[-1] @ column), rows[-1] @ a
            least = NO_EFFECT * float(np.linalg.norm(column))
        closed = a - np.outer(column, row) / direct
        if not rows:
            return _sorted(scipy.linalg.eigvals(closed), DOUBLE_ROUNDING)
        still = scipy.linalg.null_space(np.array(rows))
        return _sorted(scipy.linalg.eigvals(still.T @ closed @ still), DOUBLE_ROUNDING)

    def residues(self, input: str | int, output: str | int) -> tuple[Complex, Complex]:
        """Return the poles and the residues of one input's way to one output there.

        c (s - a)^-1 b = sum residue / (s - pole), where poles are simple.
        """
        a, b, c = self._scaled()
        j, i = self._place(input, 'input'), self._place(output, 'output')
        poles, left, right = scipy.linalg.eig(a, left=True, right=True)
        weight = np.einsum('ij,ij->j', left.conj(), right)
        residues = (c[i] @ right) * (left.conj().T @ b[:, j]) / weight
        return np.asarray(poles, dtype=np.complex128), np.asarray(residues, dtype=np.complex128)

    def frequency_response(self, omega: ArrayLike) -> Complex:
        """Return c (i omega - a)^-1 b + d.

        Parameters
        ----------
        omega : (k,) [rad/s]

        Returns
        -------
        (k, outputs, inputs) complex
        """
        a, b, c = self._scaled()
        w = np.atleast_1d(np.asarray(omega, dtype=np.float64))
        answer = np.linalg.solve(1j * w[:, None, None] * np.eye(len(a)) - a, b[None])
        return np.asarray(c @ answer + self.d, dtype=np.complex128)

    def discrete(self, period: float, delay: float = 0.0) -> DiscreteModel:
        """Return the model sampled with inputs held, exact at the samples.

        Parameters
        ----------
        period : float [s]
        delay : float [s]
            From a sample to the moment at which its input acts; need not be whole periods.

        Notes
        -----
        With delay = (w + f) period, 0 <= f < 1, the input changes once within a period: past
        inputs are states (Astrom and Wittenmark, Computer-Controlled Systems, section 2.3).
        """
        if not (np.isfinite(period) and period > 0.0):
            raise StateError(f'period must be > 0 s, got {period}')
        if not (np.isfinite(delay) and delay >= 0.0):
            raise StateError(f'delay must be >= 0 s, got {delay}')
        whole = int(delay / period + SLACK)
        part = max(delay - whole * period, 0.0)
        if part <= SLACK * period:
            part = 0.0
        s, m = self.b.shape
        a, held = _held(self.a, self.b, period)
        late = _held(self.a, self.b, period - part)[1] if part else held
        early = held - late
        past = whole + bool(part)
        # what acts at the end of a period is x, u[k - past], ..., u[k - 1], u[k]
        row = np.zeros((s, s + (past + 1) * m))
        row[:, :s] = a
        row[:, s + (past - whole) * m :][:, :m] += late
        if part:
            row[:, s : s + m] += early
        read = np.zeros((len(self.c), s + (past + 1) * m))
        read[:, :s] = self.c
        read[:, s : s + m] += self.d
        shift = np.eye(past * m, (past + 1) * m, m)
        everything = np.concatenate([row, np.hstack([np.zeros((past * m, s)), shift])])
        states = s + past * m
        names = [f'{name}[-{past - k}]' for k in range(past) for name in self.input_names]
        return DiscreteModel(
            everything[:, :states], everything[:, states:], read[:, :states], read[:, states:],
            (*self.state_names, *names), self.input_names, self.output_names, period, delay,
        )  # fmt: skip

    def to_control(self) -> StateSpace:
        """Return python-control's StateSpace, for its Bode plots, root loci, LQR and the like.

        Raises
        ------
        DenocError
            python-control is not installed (`pip install denoc_ros[control]`).
        """
        return self._to_control(0)


def _held(a: Array, b: Array, time: float) -> tuple[Array, Array]:
    """Return exp(a time) and the integral of exp(a t) b over it."""
    s, m = b.shape
    block = np.zeros((s + m, s + m))
    block[:s, :s], block[:s, s:] = a, b
    step: Array = scipy.linalg.expm(block * time)
    return step[:s, :s], step[:s, s:]


def _sorted(values: Any, rounding: float = ROUNDING) -> Complex:
    """Return complex numbers by rising size, of conjugates the one below the axis first.

    What is rounding of the largest is zero.
    """
    numbers = np.array(values, dtype=np.complex128)
    sizes = np.abs(numbers)
    numbers[sizes < rounding * sizes.max(initial=0.0)] = 0.0
    order = np.lexsort((numbers.imag, numbers.real, np.round(abs(numbers), 9)))
    return numbers[order]
