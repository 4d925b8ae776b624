"""Result of a simulation: times, states, energy and applied torques."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from denoc_ros.types import Array


@dataclass(frozen=True)
class Run:
    """A simulated motion, sampled at the output times.

    Attributes
    ----------
    t : (k,) array
        Output times [s].
    q, qd : (k, n) arrays
        Coordinates and rates, in the robot's coordinate order.
    energy : (k, 2) array
        Kinetic and potential energy [J].
    torque : (k, n) array
        Generalized forces applied [N m, N]; at prescribed joints those that the motion needs.
    coordinate_names : tuple of str
        Names of the columns of `q`.
    evaluations : int
        How often the accelerations were worked out.
    """

    t: Array
    q: Array
    qd: Array
    energy: Array
    torque: Array
    coordinate_names: tuple[str, ...]
    evaluations: int

    def coordinate(self, name: str) -> Array:
        """Return one coordinate over time.

        Parameters
        ----------
        name : str
            As in `coordinate_names`.

        Returns
        -------
        (k,) array
            rad or m.

        Raises
        ------
        KeyError
            For an unknown name.
        """
        if name not in self.coordinate_names:
            raise KeyError(
                f'run: coordinate must be one of {", ".join(self.coordinate_names)}, got {name!r}'
            )
        return self.q[:, self.coordinate_names.index(name)]

    @property
    def energy_drift(self) -> float:
        """Largest change of the total energy, over the largest kinetic energy (1 if that is 0)."""
        total = self.energy.sum(axis=1)
        scale = float(np.max(self.energy[:, 0], initial=0.0)) or 1.0
        return float(np.max(np.abs(total - total[0]), initial=0.0)) / scale
