"""Mass, centre of mass and momentum of all that moves."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from denoc_ros.dynamics.base_motion import Base
from denoc_ros.dynamics.batch import run_rows
from denoc_ros.dynamics.robot_model import RobotModel
from denoc_ros.dynamics.validation import as_output, as_rows, same_rows
from denoc_ros.kernels import composite
from denoc_ros.types import Array


class MassAndMomentum(RobotModel):
    """Sums over all bodies and payloads without those fixed to the base."""

    @property
    def mass(self) -> float:
        """Mass of all bodies and payloads [kg]."""
        return float(self._sums(self._zero, self._zero)[composite.MASS])

    def momentum(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        out: Array | None = None,
        check: bool = True,
        base: Base | None = None,
    ) -> Array:
        """Return linear and angular momentum, base axes, about the base frame's origin.

        A robot whose base floats keeps both where nothing acts from outside: no gravity, no
        forces on the base.

        Parameters
        ----------
        q, qd : (n,) or (k, n)
        out : (6,) or (k, 6), optional
        base : (twist, acceleration[, pose]), optional
            Of a base that moves: the momentum is that of the motion in space, its components
            along the base's axes of that moment.

        Returns
        -------
        (6,) or (k, 6) [kg m/s, kg m^2/s]

        Raises
        ------
        StateError
            For a wrong shape or type, or a number that is not finite.

        Notes
        -----
        Rotors (armature) turn with their joint alone and have no part in it, as they have none in
        the equations of the other coordinates.
        """
        if base is not None:
            return self._on_base(base, self.momentum, q, qd, out=out, check=check)
        sums = self._sums(q, qd, check)
        out = as_output(out, (*sums.shape[:-1], 6))
        out[...] = sums[..., : composite.MASS]
        return out

    def centre_of_mass(self, q: ArrayLike, check: bool = True) -> Array:
        """Return the centre of mass (3,) or (k, 3) of all bodies in the base frame [m]."""
        sums = self._sums(q, self._zero, check)
        return np.asarray(sums[..., composite.FIRST_MOMENT :] / sums[..., composite.MASS, None])

    def _sums(self, q: ArrayLike, qd: ArrayLike, check: bool = True) -> Array:
        """Return momentum, mass and first moment (10,) or (k, 10)."""
        states = [as_rows('q', q, self.n), as_rows('qd', qd, self.n)]
        single = all(state.ndim == 1 for state in states)
        rows = same_rows(states)
        out = np.empty((len(rows[0]), composite.MOMENTUM_SIZE))
        status = run_rows(self, composite.momentum_rows, len(out), *rows, out)
        self._raise_for_status(status, check, q=states[0], qd=states[1])
        return out[0] if single else out
