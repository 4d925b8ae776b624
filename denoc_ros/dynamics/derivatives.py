"""Derivatives of the dynamics by coordinates, rates and what drives them; docs/derivatives.md."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from denoc_ros.dynamics.batch import run_rows
from denoc_ros.dynamics.borders import as_output, as_rows, as_vector, same_rows
from denoc_ros.dynamics.constrained_model import ConstrainedModel
from denoc_ros.errors import StateError
from denoc_ros.kernels import inverse_derivatives, load_derivatives
from denoc_ros.kernels.compiled import entry, ready
from denoc_ros.kernels.handle import GOOD, MISFIT

Array = NDArray[np.float64]
Wrenches = Mapping[str, ArrayLike]
Derivatives = tuple[Array, Array, Array]
_empty = np.empty  # a global name is found more quickly than a module's


@cache
def _prepared(kernel: Any) -> Callable[..., int]:
    """Return the compiled function of a kernel, which compiles when first asked for."""
    ready(kernel)
    return entry(kernel)


class DifferentiableModel(ConstrainedModel):
    """The verbs that say how torque and acceleration change with state.

    Derivatives are matrices, a row per force or acceleration, a column per coordinate. Their
    kernels compile when the first of these verbs is called.
    """

    def inverse_dynamics_derivatives(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        wrenches: Wrenches | None = None,
        out: Sequence[Array] | None = None,
        check: bool = True,
    ) -> Derivatives:
        """Return the derivatives of :meth:`Robot.inverse_dynamics`.

        Parameters
        ----------
        q, qd, qdd : (n,) or (k, n)
        wrenches : {frame: (6,)}, optional
            External loads, base axes, linear first, at the frame's origin [N, N m]; they keep
            their direction as the frame moves.
        out : three arrays, optional
            Take the results.

        Returns
        -------
        dtau_dq, dtau_dqd, inertia : (n, n) or (k, n, n) each
            Armature, elasticity, damping and the slope of friction included; dtau_dqdd is the
            generalized inertia matrix.

        Raises
        ------
        StateError
            For a wrong shape or type, or a number that is not finite.
        """
        n = self.n
        if out is None:
            result = (_empty((n, n)), _empty((n, n)), _empty((n, n)))
        else:
            result = _three(out)
        kernel = _prepared(inverse_derivatives.inverse_dynamics_derivatives)
        status = kernel(self.handle, q, qd, qdd, *result)
        if status != GOOD:
            arguments = {'q': q, 'qd': qd, 'qdd': qdd}
            rows = inverse_derivatives.inverse_dynamics_derivatives_rows
            result = self._settle_derivatives(status, rows, arguments, out, result, check)
        if wrenches:
            self._subtract_loads(as_rows('q', q, n), wrenches, result[0])
        return result

    def _settle_derivatives(
        self,
        status: int,
        rows_kernel: Any,
        arguments: dict[str, ArrayLike],
        out: Sequence[Array] | None,
        result: Derivatives,
        check: bool,
    ) -> Derivatives:
        """Return what a kernel did not give at the first try: rows, lists, wrong arguments."""
        n = self.n
        arrays = {name: as_rows(name, value, n) for name, value in arguments.items()}
        if status == MISFIT:
            rows = same_rows(list(arrays.values()))
            k = len(rows[0])
            single = all(array.ndim == 1 for array in arrays.values())
            shape = (n, n) if single else (k, n, n)
            given = (None, None, None) if out is None else _three(out)
            a, b, c = (as_output(one, shape) for one in given)
            result = (a, b, c)
            flat = [one.reshape(k, n, n) for one in result]
            status = run_rows(self, rows_kernel, k, rows, flat)
        self._judge(status, check, **arrays)
        return result

    def _subtract_loads(self, q: Array, wrenches: Wrenches, out: Array) -> None:
        """Subtract from out (n, n) or (k, n, n) the derivative by q of what wrenches do."""
        count = out.shape[0] if out.ndim == 3 else 1
        rows = np.array(np.broadcast_to(q, (count, self.n)))
        for frame, wrench in wrenches.items():
            inputs = (rows, self._row(frame), as_vector('wrench', wrench, (6,)))
            flat = out.reshape(count, self.n, self.n)
            kernel = load_derivatives.subtract_load_rows
            self.judge(run_rows(self, kernel, count, inputs, (flat,)), q=q)


def _three(out: Sequence[Array]) -> Derivatives:
    """Return three result arrays, or raise StateError."""
    if len(out) != 3:
        raise StateError(f'out must be three arrays, got {len(out)}')
    return out[0], out[1], out[2]
