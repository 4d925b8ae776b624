"""Energy balance and loop closure of a simulated run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import cumulative_trapezoid

from denoc_ros.bags.run import RecordedTopics
from denoc_ros.dynamics.robot import Robot
from denoc_ros.pages.figures import Curve, Ink, Panel, line_figure
from denoc_ros.pages.html_page import Card, PageSection, Verdict, engineering
from denoc_ros.types import Array

CLOSED = 1e-9  # m or rad: what a simulation keeps its loops to
SMALLEST = 1e-17  # what an error of zero is drawn as


@dataclass(frozen=True)
class EnergyBalance:
    """Energies and closure of a simulated run."""

    t: Array  # (k,) times [s]
    # (k,) energies [J]; potential as `Robot.energy` has it
    kinetic: Array
    potential: Array
    # (k,) done by the joints' efforts since the start, by the trapezoidal rule [J]
    work: Array | None
    # (k,) largest error of the loops [m or rad]; None for a robot without loops
    closure: Array | None

    @property
    def total(self) -> Array:
        """Kinetic and potential energy, (k,) [J]."""
        return np.asarray(self.kinetic + self.potential)

    @property
    def change(self) -> float:
        """Largest change of the total energy [J]."""
        return float(np.max(np.abs(self.total - self.total[0])))

    @property
    def open(self) -> float | None:
        """Largest error of the loops in the whole run [m or rad]."""
        return None if self.closure is None else float(np.max(self.closure))

    def summary(self) -> dict[str, Any]:
        """Return the numbers, ready for JSON: SI units."""
        return {
            'largest_kinetic_energy': float(np.max(self.kinetic)),
            'largest_energy_change': self.change,
            'work': None if self.work is None else float(self.work[-1]),
            'closure_error': self.open,
        }


def energy_balance(recording: RecordedTopics, robot: Robot) -> EnergyBalance | None:
    """Return the energies of a simulated run; None where it does not have the robot's states.

    Parameters
    ----------
    recording : RecordedTopics
        With the topic plant/true_modal_state.
    """
    state = recording.series('plant/true_modal_state')
    rates = recording.series('plant/true_modal_state', 'velocity')
    names = tuple(robot.coordinate_names)
    if state is None or rates is None or set(state.names) != set(names):
        return None
    q = np.ascontiguousarray(state.select(names).values)
    qd = np.ascontiguousarray(rates.select(names).values)
    kinetic, potential = robot.energy(q, qd).T
    closure = np.max(np.abs(robot.closure(q)), axis=1) if robot.tree.loops else None
    return EnergyBalance(state.t, kinetic, potential, _work(recording), closure)


def _work(recording: RecordedTopics) -> Array | None:
    effort = recording.series('joint_states', 'effort')
    rates = recording.series('joint_states', 'velocity')
    if effort is None or rates is None:
        return None
    power = np.sum(effort.values * rates.values, axis=1)
    return np.asarray(cumulative_trapezoid(power, effort.t, initial=0.0))


def verdict(found: EnergyBalance, said: Sequence[str]) -> Verdict:
    """Return a simulation in one sentence; loops that open make it doubtful."""
    parts = [f'The simulation went to its end at {found.t[-1]:.4g} s', *said]
    closed = found.open is None or found.open <= CLOSED
    if found.open is not None:
        kept = f'stay closed to {found.open:.1e}' if closed else f'open by {found.open:.1e}'
        parts.append(f'its loops {kept} m or rad')
    return Verdict(f'{"; ".join(parts)}.', 'good' if closed else 'doubtful')


def cards(found: EnergyBalance) -> list[Card]:
    """Return the figures of merit of a simulation."""
    shown = [
        Card('Largest kinetic energy', engineering(float(np.max(found.kinetic)), 'J')),
        Card('Change of total energy', engineering(found.change, 'J'), 'largest, from the start'),
    ]
    if found.work is not None:
        shown.append(
            Card('Work of the joints', engineering(float(found.work[-1]), 'J'), 'to the end')
        )
    if found.open is not None:
        shown.append(Card('Loops open by', f'{found.open:.1e}', 'm or rad, largest'))
    return shown


def sections(found: EnergyBalance) -> Sequence[PageSection]:
    """Return the sections on energy, and on loops where there are any."""
    curves = [
        Curve('kinetic', Ink.PHASES[0], found.t, found.kinetic),
        Curve(
            'potential, from the start',
            Ink.PHASES[1],
            found.t,
            found.potential - found.potential[0],
        ),
    ]
    total = found.total - found.potential[0]
    panels = [Panel('energies', 'J', curves)]
    balanced = [Curve('total', Ink.TRUTH, found.t, total - total[0])]
    if found.work is not None:
        balanced.append(Curve('work of the joints', Ink.PHASES[2], found.t, found.work, True))
    panels.append(Panel('total energy and work, from the start', 'J', balanced))
    shown = [
        PageSection(
            'Energy',
            'Work of the joints minus change of total energy is the dissipation by friction and '
            'damping, and the integration error of the recorded times. Potential energy: gravity '
            'and strain.',
            [line_figure(panels)],
        )
    ]
    if found.closure is not None:
        error = Curve('', Ink.PHASES[1], found.t, np.maximum(found.closure, SMALLEST))
        panel = Panel('largest error of the loops', 'm or rad', [error], log_y=True)
        shown.append(
            PageSection(
                'Closed loops', 'How far the loops are from closed.', [line_figure([panel])]
            )
        )
    return shown
