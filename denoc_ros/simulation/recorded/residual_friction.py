"""Friction of joints, by least squares on the torque residual of a model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from denoc_ros.model.joint_friction import Friction, slip
from denoc_ros.types import Array, Flags

TERMS = ('viscous', 'coulomb', 'offset')
WINDOW = 1.0  # s that residuals are taken to hang together for
NEGLIGIBLE = 1e-9  # share of a term that the other terms do not already explain


@dataclass(frozen=True)
class FrictionFit:
    """Fitted friction and how sure it is."""

    friction: Friction  # what could not be told apart (a joint that does not move) is 0
    # (joints, 3) standard errors of viscous, Coulomb and offset: as if residuals were independent,
    # and with residuals of a second hanging together; NaN where nothing could be fitted
    formal: Array
    by_window: Array
    size: Array  # (joints, 3) rms of each term's torque [N m, N]
    # (joints,) what the model without any joint friction leaves of the measured effort, and what
    # is left with it [N m, N]
    rms_before: Array
    rms_after: Array
    explained: Array  # (joints,) share of the first's mean square that went
    samples: NDArray[np.int64]  # (joints,) int


class FrictionFitter:
    """Gathers normal equations block by block.

    Parameters
    ----------
    joints : int
        How many.
    """

    def __init__(self, joints: int) -> None:
        self._joints = joints
        self._windows: dict[tuple[int, int], tuple[Array, Array]] = {}
        self._motions = 0
        self._square = np.zeros(joints)
        self._samples = np.zeros(joints, dtype=np.int64)

    def add(self, t: Array, qd: Array, rest: Array, starts: Flags) -> None:
        """Take rows in.

        Parameters
        ----------
        t : (k,) array
            Times [s].
        qd, rest : (k, joints) array
            Rates, and measured effort minus the model's torque without friction [N m, N]; rows
            with a NaN do not count.
        starts : (k,) bool array
            Where a motion begins that does not go on from the row before.
        """
        known = np.isfinite(rest)
        rest = np.where(known, rest, 0.0)
        terms = np.stack([qd, slip(qd), np.ones_like(qd)], axis=-1)
        terms = np.where(known[..., None], terms, 0.0)
        self._square += np.sum(rest**2, axis=0)
        self._samples += np.count_nonzero(known, axis=0)
        motions = self._motions + np.cumsum(starts)
        self._motions = int(motions[-1])
        numbers = np.column_stack([motions, np.floor(t / WINDOW).astype(np.int64)])
        for motion, second in np.unique(numbers, axis=0).tolist():
            number, rows = (motion, second), (numbers == (motion, second)).all(axis=1)
            matrix = np.einsum('kji,kjl->jil', terms[rows], terms[rows])
            vector = np.einsum('kji,kj->ji', terms[rows], rest[rows])
            before = self._windows.get(number, (0.0, 0.0))
            self._windows[number] = before[0] + matrix, before[1] + vector

    def fit(self) -> FrictionFit:
        """Return the friction that leaves the least mean square."""
        matrices = np.array([matrix for matrix, _ in self._windows.values()])
        vectors = np.array([vector for _, vector in self._windows.values()])
        found = np.zeros((self._joints, 3))
        formal, by_window = np.full((2, self._joints, 3), np.nan)
        left = self._square.copy()
        for joint in range(self._joints):
            matrix, vector = matrices[:, joint], vectors[:, joint]
            terms = _distinct(matrix.sum(axis=0))
            if not terms:
                continue
            matrix, vector = matrix[:, terms][:, :, terms], vector[:, terms]
            inverse = np.linalg.inv(matrix.sum(axis=0))
            value = inverse @ vector.sum(axis=0)
            left[joint] = max(0.0, left[joint] - value @ vector.sum(axis=0))
            free = max(1, int(self._samples[joint]) - len(terms))
            scores = vector - matrix @ value
            windows = len(scores)
            spread = inverse @ (scores.T @ scores) @ inverse
            found[joint, terms] = value
            formal[joint, terms] = np.sqrt(np.diag(inverse) * left[joint] / free)
            if windows > len(terms):
                few = windows / (windows - len(terms))
                by_window[joint, terms] = np.sqrt(np.diag(spread) * few)
        samples = np.maximum(self._samples, 1)
        squares = np.diagonal(matrices.sum(axis=0), axis1=1, axis2=2)
        return FrictionFit(
            Friction(*found.T),
            formal,
            by_window,
            np.abs(found) * np.sqrt(squares / samples[:, None]),
            np.sqrt(self._square / samples),
            np.sqrt(left / samples),
            1.0 - left / np.where(self._square > 0.0, self._square, 1.0),
            self._samples,
        )


def _distinct(matrix: Array) -> list[int]:
    """Return the terms that the others before them do not make up, the offset first."""
    kept: list[int] = []
    for term in (2, 1, 0):
        size = matrix[term, term]
        across = matrix[np.ix_(kept, [term])][:, 0]
        made_up = across @ np.linalg.solve(matrix[np.ix_(kept, kept)], across) if kept else 0.0
        if size > 0.0 and size - made_up > NEGLIGIBLE * size:
            kept.append(term)
    return sorted(kept)
