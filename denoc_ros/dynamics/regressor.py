"""Regressor: derivatives of generalized forces by the parameters in which they are linear."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from denoc_ros.dynamics.base_motion import Base, on_base
from denoc_ros.dynamics.parameter_columns import (
    DIAGONAL_TERMS,
    Column,
    find_columns,
    massless,
)
from denoc_ros.dynamics.tree_dynamics import TreeDynamics
from denoc_ros.dynamics.validation import as_output, as_states, same_rows
from denoc_ros.model.friction import slip
from denoc_ros.types import Array


class TorqueRegressor(TreeDynamics):
    """Torque regressor: derivatives of inverse dynamics by parameters in which they are linear."""

    def torque_regressor(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        paths: Sequence[str],
        out: Array | None = None,
        base: Base | None = None,
    ) -> Array:
        """Return the derivatives of the generalized forces by parameters: exact, for any values.

        Parameters
        ----------
        q, qd, qdd : (n,) or (k, n)
        paths : sequence of str
            Dotted paths as overrides have them, and more (docs/linear_models.md):
            `beam.<link>.<y|z>.<ei|damping|damping_ratio>` and
            `beam.<link>.torsion.<gj|polar_inertia|damping|damping_ratio>`, of a mode alone with
            its number behind (`beam.arm.y.damping.2`); `beam.<link>.mass_per_length`, the rigid
            rest of the link held; `joint.<name>.<damping|friction|armature>` and `damping.*`;
            `payload.<link>.<mass|inertia.ixx|...>` about its centre of mass, which is held;
            `link.<link>.<mass|first_moment.x|...|inertia.ixx|...>` about the link frame's
            origin: the ten of a rigid body.
        out : (n, parameters) or (k, n, parameters), optional
        base : (twist, acceleration[, pose]), optional
            A base that moves, as of :meth:`Robot.inverse_dynamics`.

        Returns
        -------
        (n, parameters) or (k, n, parameters)
            Columns in the order of `paths`. For parameters p that are not of one number twice,
            tau(p) = regressor @ p + rest with a rest that does not depend on p.

        Raises
        ------
        ConfigError
            With every path that the robot does not have, or in which its forces are not linear.
        StateError
            For a wrong shape or type, or a number that is not finite.

        Notes
        -----
        Damping enters by its coefficients [N s/m, N m s/rad]: a damping ratio is one worked out
        as the model is loaded, and the columns of stiffness and mass hold it.
        """
        if base is not None:
            return on_base(self, self.torque_regressor, locals())
        given = zip(('q', 'qd', 'qdd'), (q, qd, qdd), strict=True)
        states = [as_states(name, value, self.n) for name, value in given]
        columns = find_columns(self, paths)
        single = all(state.ndim == 1 for state in states)
        rows = same_rows(states)
        k = len(rows[0])
        shape = (self.n, len(columns))
        result = as_output(out, shape if single else (k, *shape))
        _write(self, columns, rows, result.reshape(k, *shape))
        return result


def _write(
    robot: TreeDynamics, columns: Iterable[Column], rows: Sequence[Array], out: Array
) -> None:
    """Write columns (k, n, parameters) at states (k, n)."""
    q, qd, qdd = rows
    factors = dict(zip(DIAGONAL_TERMS, (q, qd, slip(qd), qdd), strict=True))
    bare: TreeDynamics | None = None
    for index, column in enumerate(columns):
        if column.term in factors:
            np.multiply(factors[column.term], column.values, out=out[:, :, index])
            continue
        if bare is None:
            bare = massless(robot)
        constants = bare.constants[column.constants]
        bare.constants[column.constants] = column.values
        out[:, :, index] = bare.inverse_dynamics(q, qd, qdd)
        bare.constants[column.constants] = constants
