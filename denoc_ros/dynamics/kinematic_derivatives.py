"""Motion of frames, deflections and sensors, and its derivatives by the state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from denoc_ros.dynamics import structure
from denoc_ros.dynamics.base_motion import Base, on_base
from denoc_ros.dynamics.batch import run_rows
from denoc_ros.dynamics.section import AnySection, SegmentedSection
from denoc_ros.dynamics.tree_dynamics import TreeDynamics
from denoc_ros.dynamics.validation import as_output, as_states, same_rows
from denoc_ros.errors import StateError
from denoc_ros.kernels import frame_motion
from denoc_ros.types import Array


class KinematicDerivatives(TreeDynamics):
    """Derivatives of frames, beams and sensors by the state; exact, by recursion.

    Of a frame: linear first, base axes, at its origin. The derivative of a pose by q is the
    Jacobian. Kernels compile when first asked for.
    """

    def frame_motion(
        self,
        frame: str,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike | None = None,
        out: Array | None = None,
        base: Base | None = None,
    ) -> Array:
        """Return a frame's twist and acceleration (2, 6) or (k, 2, 6).

        Parameters
        ----------
        frame : link or loop frame
        q, qd : (n,) or (k, n)
        qdd : (n,) or (k, n), optional
            Default zero.
        out : (2, 6) or (k, 2, 6), optional
        base : (twist, acceleration[, pose]), optional
            Of a base that moves, as of :meth:`Robot.inverse_dynamics`: the motion is then that in
            space, its components along the base's axes of that moment.

        Returns
        -------
        [[v, omega], [a, alpha]] : [m/s, rad/s], [m/s^2, rad/s^2]
            The acceleration is the classical one, J q'' + J' q': the second derivative of the
            position, without gravity.

        Raises
        ------
        StateError
            For an unknown frame, a wrong shape or type, or a number that is not finite.
        """
        if base is not None:
            return on_base(self, self.frame_motion, locals())
        states = (q, qd, self._zero if qdd is None else qdd)
        return self._of_motion(frame_motion.frame_motion_rows, (2, 6), frame, states, out)

    def frame_jacobian_rate(
        self, frame: str, q: ArrayLike, qd: ArrayLike, out: Array | None = None
    ) -> Array:
        """Return the time derivative (6, n) or (k, 6, n) of a frame's Jacobian along q'.

        Parameters and errors as in :meth:`frame_motion`.
        """
        kernel = frame_motion.frame_jacobian_rate_rows
        return self._of_motion(kernel, (6, self.n), frame, (q, qd), out)

    def frame_velocity_derivatives(
        self, frame: str, q: ArrayLike, qd: ArrayLike, out: Array | None = None
    ) -> tuple[Array, Array]:
        """Return the derivatives of a frame's twist by q and q', (6, n) or (k, 6, n) each.

        Parameters and errors as in :meth:`frame_motion`; out is (2, 6, n) or (k, 2, 6, n).

        Notes
        -----
        dv/dq' is the Jacobian. dv/dq is its rate but for omega, where columns T of the Jacobian
        do not commute: domega/dq_j = T_j' + T_j x omega.
        """
        kernel = frame_motion.frame_velocity_derivatives_rows
        made = self._of_motion(kernel, (2, 6, self.n), frame, (q, qd), out)
        return made[..., 0, :, :], made[..., 1, :, :]

    def frame_acceleration_derivatives(
        self,
        frame: str,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        out: Array | None = None,
    ) -> tuple[Array, Array, Array]:
        """Return the derivatives of a frame's acceleration by q, q' and q'', (6, n) each.

        Parameters and errors as in :meth:`frame_motion`; of rows (k, 6, n) each, out is
        (3, 6, n) or (k, 3, 6, n). That by q'' is the Jacobian.
        """
        kernel = frame_motion.frame_acceleration_derivatives_rows
        made = self._of_motion(kernel, (3, 6, self.n), frame, (q, qd, qdd), out)
        return made[..., 0, :, :], made[..., 1, :, :], made[..., 2, :, :]

    def section(self, link: str, station: float | None = None) -> tuple[AnySection, slice]:
        """Return the cross-section of a link's beam (default the tip) and its amplitudes."""
        key = (link, station)
        if key not in self._sections:
            self._sections[key] = structure.find_section(self, link, station)
        return self._sections[key]

    def tip_deflection(self, link: str, q: ArrayLike, station: float | None = None) -> Array:
        """Return the deflection (3,) [m] of a link's beam in the beam frame; default the tip."""
        section, amplitudes = self.section(link, station)
        q = as_states('q', q, self.n)
        return section.deflection(q[..., amplitudes])[..., :3]

    def tip_deflection_jacobian(
        self, link: str, q: ArrayLike, station: float | None = None, out: Array | None = None
    ) -> Array:
        """Return the derivative (3, n) or (k, 3, n) of :meth:`tip_deflection` by q.

        Its time derivative along q', which the rate's derivative by q is too, is that of u_x
        alone where the link is one segment: see :meth:`tip_deflection_jacobian_rate`.
        """
        section, own = self.section(link, station)
        q = as_states('q', q, self.n)
        result = as_output(out, (*q.shape[:-1], 3, self.n))
        result[...] = 0.0
        result[..., own] = section.jacobian(q[..., own])
        return result

    def tip_deflection_jacobian_rate(
        self,
        link: str,
        qd: ArrayLike,
        station: float | None = None,
        out: Array | None = None,
        q: ArrayLike | None = None,
    ) -> Array:
        """Return the time derivative (3, n) or (k, 3, n) of :meth:`tip_deflection_jacobian`.

        Of a link of one segment only foreshortening bends with the state, and its Jacobian is
        linear in q: no q is needed. A link of several segments needs it.

        Raises
        ------
        StateError
            For a wrong shape or type, or no q for a link of several segments.
        """
        section, own = self.section(link, station)
        qd = as_states('qd', qd, self.n)
        if not isinstance(section, SegmentedSection):
            rows = section.jacobian_rate(qd[..., own])
        elif q is None:
            raise StateError(f'link {link!r}: q must be given where it has segments, got none')
        else:
            rows = section.jacobian_rate(as_states('q', q, self.n)[..., own], qd[..., own])
        result = as_output(out, (*rows.shape[:-2], 3, self.n))
        result[...] = 0.0
        result[..., own] = rows
        return result

    def _of_motion(
        self,
        kernel: Any,
        shape: tuple[int, ...],
        frame: str,
        states: Sequence[ArrayLike],
        out: Array | None,
    ) -> Array:
        """Call a kernel on a frame's motion q, q' (and q''), at one state or many."""
        named = zip(('q', 'qd', 'qdd'), states, strict=False)
        arrays = [as_states(name, state, self.n) for name, state in named]
        arrays += [self._zero] * (3 - len(arrays))
        single = all(array.ndim == 1 for array in arrays)
        rows = [array[None] for array in arrays] if single else same_rows(arrays)
        count = len(rows[0])
        out = as_output(out, shape if single else (count, *shape))
        row = np.array([float(self._row(frame))])
        run_rows(self, kernel, count, *rows, row, out[None] if single else out)
        return out
