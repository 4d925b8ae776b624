"""What a run comes down to: its verdict, and how far its tip was off."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from denoc_ros.bags.run import Diagnostic
from denoc_ros.bags.series import Series
from denoc_ros.model.joint_units import Units
from denoc_ros.pages.loop_timing import NodeWarnings, warnings
from denoc_ros.reports import headline, sections
from denoc_ros.reports.headline import summary_lines
from denoc_ros.reports.measures import Deflection, PhaseMeasures, summarize

T = np.linspace(0.0, 15.0, 1501)
STOP = 10.0  # s
BENT = 0.1 * np.sin(T)  # m


def phase(name: str, predicted: NDArray[np.float64], distance: Any = 0.0) -> PhaseMeasures:
    gap = np.broadcast_to(distance, len(T))[:, np.newaxis]
    return PhaseMeasures(
        name=name,
        begin=0.0,
        end=float(T[-1]),
        joints=None,
        error=None,
        tip_error=Series(T, ('tool',), gap),
        stop=STOP,
        torque=None,
        effort=None,
        deflections=(Deflection('arm/uy', T, predicted, BENT),),
    )


@pytest.mark.parametrize(
    ('predicted', 'tone', 'text'),
    [
        (1.02 * BENT, 'good', r'deflection is predicted to 1\.\d % of its peak or better'),
        (0.2 * BENT, 'doubtful', r'wrong by 5\d % of its peak \(arm/uy, second\)'),
        (BENT + 5e-5, 'good', 'is predicted to'),
    ],
)
def test_a_deflection_that_is_predicted_badly_makes_a_run_doubtful(
    predicted: NDArray[np.float64], tone: str, text: str
) -> None:
    phases = [phase('first', BENT), phase('second', predicted)]
    found = headline.verdict(phases, {}, 15.0, Units())
    assert found.tone == tone
    with pytest.raises(ValueError, match=text):
        raise ValueError(found.text)


def test_the_failure_of_a_session_is_its_headline() -> None:
    phases = [phase('first', BENT), phase('second (unfinished)', 0.2 * BENT)]
    cause = 'plant: process must keep running, got exit status 1\n  /home/me/arm.urdf: bad'
    found = headline.verdict(phases, {}, 15.0, Units(), cause, 'second')
    assert found.tone == 'bad'
    assert found.text.startswith('The session ended in phase “second” before its end: plant: proc')
    # the unfinished phase says nothing of how well deflection is predicted
    assert 'Until then' in found.text
    assert 'wrong' not in found.text
    told = sections.failure(cause)
    assert told is not None
    assert told.tables[0].rows == [['arm.urdf: bad']]
    assert sections.failure('') is None


def test_an_error_that_nobody_sees_is_no_bad_prediction() -> None:
    tiny = Deflection('arm/uy', T, 3e-5 * np.cos(T), 3e-5 * np.sin(T))
    still = PhaseMeasures('run', 0.0, 15.0, None, None, None, np.nan, None, None, (tiny,))
    assert headline.verdict([still], {}, 15.0, Units()).tone == 'good'


def test_warnings_count_where_a_whole_second_of_them_is_within_a_phase() -> None:
    """Between phases nodes are restarted, and those that wait for them say so."""
    second = 10**9
    statuses = [
        Diagnostic(round(t * second), 'plant: loop', level, f'at {t}', '', {})
        for t, level in [(9.0, 1), (10.4, 1), (12.0, 0), (13.0, 1), (19.9, 1), (20.5, 1)]
    ]
    found = {'plant: loop': (2, 'at 19.9', ('rigid',))}
    assert warnings(statuses, [('rigid', (10 * second, 20 * second))]) == found
    halves = [('rigid', (0, 15 * second)), ('flexible', (15 * second, 2**63))]
    assert warnings(statuses, halves)['plant: loop'].phases == ('rigid', 'flexible')
    assert warnings(statuses, [('rigid', (0, 2**63))])['plant: loop'].times == 5
    assert not warnings(statuses, [])


def test_a_warning_is_told_with_its_phase_where_there_are_several() -> None:
    said = {'feedforward: torque': NodeWarnings(3, 'torque clamped', ('second',))}
    both = [phase('first', BENT), phase('second', BENT)]
    found = headline.verdict(both, said, 15.0, Units())
    assert found.tone == 'doubtful'
    assert found.text.endswith('nodes warned: feedforward: torque (second).')
    assert headline.verdict(both[1:], said, 15.0, Units()).text.endswith('feedforward: torque.')


def test_the_tip_is_told_moving_after_the_stop_and_settled() -> None:
    distance = np.select([T <= STOP, T <= STOP + 3.0], [0.3, 0.2], 0.05)
    found = phase('run', BENT, distance)
    numbers = summarize((found,))['run']
    assert numbers['tip_error_moving']['max'] == 0.3
    assert numbers['tip_error_after_stop']['max'] == 0.2
    assert numbers['tip_error_settled']['max'] == 0.05
    (line,) = (
        line
        for line in summary_lines({'phases': {'run': numbers}, 'loops': {}})
        if 'tip off' in line
    )
    assert '300 mm rms while moving, 200 mm at most after the stop, 50 mm from 3 s' in line
    section = sections.tip([found])
    assert section is not None
    assert [list(row[1:]) for row in section.tables[0].rows] == [
        ['300 mm', '300 mm', '200 mm', '50 mm']
    ]


def test_the_figure_of_the_tip_averages_squares() -> None:
    t = np.linspace(0.0, 1.0, 1000, endpoint=False)
    middles, distance = sections.averaged(t, 0.2 * np.abs(np.sin(200.0 * np.pi * t)))
    assert len(middles) == 20
    # ten whole periods of the square in each stretch, to the rounding of its ends
    np.testing.assert_allclose(distance, 0.2 / np.sqrt(2.0), rtol=0.02)
    assert sections.tip([]) is None


def moved(name: str, error: float) -> PhaseMeasures:
    """Return a phase whose tip is off by an error [m] while it moves."""
    tip = Series(T, ('tool',), np.full((len(T), 1), error))
    return PhaseMeasures(name, 0.0, 15.0, None, None, tip, 7.0, None, None, ())


def test_a_warning_in_a_phase_that_another_outdoes_does_not_make_the_run_doubtful() -> None:
    said = {'feedforward: torque': NodeWarnings(1, 'torque clamped', ('swinging',))}
    found = headline.verdict([moved('swinging', 1.0), moved('exact', 1e-3)], said, 15.0, Units())
    assert found.tone == 'good'
    assert 'off where it was asked to be by 1 m (swinging) and 1 mm (exact) rms' in found.text
    near = headline.verdict([moved('swinging', 2e-3), moved('exact', 1e-3)], said, 15.0, Units())
    assert near.tone == 'doubtful'


def test_numbers_identified_are_shown_beside_the_true_ones() -> None:
    number: dict[str, Any] = {'path': 'payload.tool.com.x', 'start': 0.0, 'value': -1.01}
    number |= {'verdict': 'found', 'interval': [-1.02, None]}
    found = {'from': 'loose', 'numbers': [number]}
    plant = {'payload.tool.com': [-1.0, 0.0, 0.0]}
    known = {'name': 'known', 'plant': plant, 'identified': found}
    phases: list[dict[str, Any]] = [{'name': 'loose'}, known]
    section = sections.identified(phases)
    assert section is not None
    row = ['payload.tool.com.x', '0', '-1.01', '–', '-1', 'found']
    assert list(section.tables[0].rows) == [row]
    assert sections.identified(phases[:1]) is None
