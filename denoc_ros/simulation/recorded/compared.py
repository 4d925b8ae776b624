"""What a phase of a recording shows: computed beside measured torque and deflection."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from denoc_ros.estimation.torque_along import Torques
from denoc_ros.model.numbers import Value
from denoc_ros.simulation.recorded.agreement import (
    BINS,
    Agreement,
    Comparison,
    Shares,
    Traces,
)
from denoc_ros.simulation.recorded.plausibility import EffortSizes, Jump, effort_sums
from denoc_ros.types import Array, Flags

Differences = Mapping[str, tuple[Value | None, Value | None]]

FITTED = ('friction', 'offset')  # terms of a torque that a fit of friction gives
MEASURED = 'measured'


@dataclass(frozen=True, kw_only=True)
class Compared:
    """What the joint states of a phase show, or those of all phases.

    Attributes
    ----------
    name : str
        Of the phase; '' for all.
    begin, duration : float
        Time of the first joint state [s since that of all], and from it to the last one [s].
    samples, incomplete, repeated, motions : int
        Joint states replayed; left out because a joint is missing; left out because they are not
        later than one before; stretches of motion without a gap or jump.
    torque : dict of str to Agreement
        The measured effort over that of each model, by joint; empty where none was measured.
    commanded : Agreement or None
        The feedforward's effort over the best model's.
    shares : dict of str to (joints,) array
        What each term explains of the measured effort (of the computed one where none was
        measured).
    deflection : dict of str to Agreement
        By topic that has deflections: over the predicted ones.
    jumps : tuple of Jump
        Of the positions.
    sizes : EffortSizes or None
        None where no effort was measured.
    plant : mapping of str to (value, value)
        By dotted path, numbers of the session's plant that differ from those of the model, and
        these.
    """

    name: str
    begin: float
    duration: float
    samples: int
    incomplete: int
    repeated: int
    motions: int
    torque: dict[str, Agreement]
    commanded: Agreement | None
    shares: dict[str, Array]
    deflection: dict[str, Agreement]
    jumps: tuple[Jump, ...]
    sizes: EffortSizes | None
    plant: Differences = field(default_factory=dict)


class Comparer:
    """Compares the rows of a phase, block by block.

    Parameters
    ----------
    joints, models, deflections, topics : sequence of str
        Names of the driven joints, of the models, of the deflections, and topics that have these.
    has_commanded : bool
        Whether a feedforward's effort is compared.
    period : float
        Usual time between rows [s].
    offset : (joints,) array or None
        Fitted offset [N m, N]; None where no friction was fitted.
    bins : int
        Of the curves.
    """

    def __init__(
        self,
        joints: Sequence[str],
        models: Sequence[str],
        deflections: Sequence[str],
        topics: Sequence[str],
        has_commanded: bool,
        period: float,
        offset: Array | None,
        bins: int = BINS,
    ) -> None:
        count = len(joints)
        self._offset = offset
        self.begin, self.end = np.inf, -np.inf
        self.samples = self.motions = 0
        self._torque = {model: Comparison(count, period) for model in models}
        self._commanded = Comparison(count, period) if has_commanded else None
        self._deflection = {topic: Comparison(len(deflections), period) for topic in topics}
        self._shares, self._shares_computed = Shares(count), Shares(count)
        self._sums = np.zeros((7, count))
        self.torque_traces = {name: Traces(joints, bins) for name in (MEASURED, *models)}
        self.deflection_traces = {name: Traces(deflections, bins) for name in ('replay', *topics)}

    def add(
        self,
        t: Array,
        starts: Flags,
        torques: Torques,
        effort: Array,
        commanded: Array | None,
        deflections: dict[str, Array],
    ) -> None:
        """Take rows in.

        Parameters
        ----------
        t, starts : (k,) arrays
            Times [s], and where a motion begins anew.
        effort, commanded : (k, joints) array
            [N m, N]; NaN where there is none.
        deflections : dict of str to (k, deflections) array
            By topic.
        """
        self.samples += len(t)
        self.motions += int(np.count_nonzero(starts))
        self.begin, self.end = min(self.begin, float(t[0])), max(self.end, float(t[-1]))
        self.torque_traces[MEASURED].add(t, effort)
        for name, computed in torques.models.items():
            self.torque_traces[name].add(t, computed)
            self._torque[name].add(t, effort, computed, starts)
        self._shares.add(effort, torques.parts)
        self._shares_computed.add(torques.best, torques.parts)
        self._add_sizes(effort, torques)
        if self._commanded is not None and commanded is not None:
            self._commanded.add(t, commanded, torques.best, starts)
        if torques.deflection is None:
            return
        self.deflection_traces['replay'].add(t, torques.deflection[0])
        for topic, other in deflections.items():
            self.deflection_traces[topic].add(t, other)
            self._deflection[topic].add(t, other, torques.deflection[0], starts)

    def include(self, other: Comparer) -> None:
        """Take the rows of another one in, without its curves."""
        self.samples += other.samples
        self.motions += other.motions
        self.begin, self.end = min(self.begin, other.begin), max(self.end, other.end)
        for mine, theirs in ((self._torque, other._torque), (self._deflection, other._deflection)):
            for name, comparison in theirs.items():
                mine[name].include(comparison)
        if self._commanded is not None and other._commanded is not None:
            self._commanded.include(other._commanded)
        self._shares.include(other._shares)
        self._shares_computed.include(other._shares_computed)
        self._sums += other._sums

    def result(
        self, name: str = '', incomplete: int = 0, repeated: int = 0, jumps: Sequence[Jump] = ()
    ) -> Compared:
        """Return the numbers, with those of the messages that were left out."""
        torque = {model: one.result() for model, one in self._torque.items()}
        known = any(one.samples.any() for one in torque.values())
        return Compared(
            name=name,
            begin=self.begin if self.samples else 0.0,
            duration=max(0.0, self.end - self.begin),
            samples=self.samples,
            incomplete=incomplete,
            repeated=repeated,
            motions=self.motions,
            torque=torque if known else {},
            commanded=None if self._commanded is None else self._commanded.result(),
            shares=(self._shares if known else self._shares_computed).result(),
            deflection={topic: one.result() for topic, one in self._deflection.items()},
            jumps=tuple(jumps),
            sizes=self._sizes() if known else None,
        )

    def _add_sizes(self, effort: Array, torques: Torques) -> None:
        fitted = FITTED if self._offset is not None else ()
        kept = [part for name, part in torques.parts.items() if name not in fitted]
        expected = np.sum(kept, axis=0)
        self._sums += effort_sums(effort, expected, torques.parts['gravity'])

    def _sizes(self) -> EffortSizes:
        if self._offset is None:
            return EffortSizes.of_sums(self._sums, None)
        shares = self._shares.result()
        fitted = {term: shares[term] for term in FITTED}
        return EffortSizes.of_sums(self._sums, self._offset, fitted)
