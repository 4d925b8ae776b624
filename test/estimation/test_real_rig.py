"""The observer on records of a real rig: two flexible links, hub angles in, deflections out.

The records hold strain behind a filter of 2 Hz (its parameters stand in the rig's file), so the
comparison is with the filter undone, or with the estimate behind the same filter. The fields
called X2_sim are the second stage's measurement, which a test below shows by a long record.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import scipy.io
from data_files import RIG_RECORDS, rig_run
from scipy.signal import TransferFunction, lsim, savgol_filter

import denoc_ros as dn
from denoc_ros.estimation.fusion import FusionSettings
from denoc_ros.estimation.observer import Observer
from denoc_ros.estimation.observer_settings import ObserverSettings
from denoc_ros.types import Array

URDF = Path(__file__).resolve().parents[2] / 'config' / 'robots' / 'two_flexible_links.urdf'
LONG_RECORD = RIG_RECORDS / 'lqr_full_10deg_thin.mat'
STEP = 2e-3
OMEGA, DAMPING = 12.566370614359172, 0.9  # of the strain filters [rad/s]
WINDOW = 61  # samples of the polynomials that undo them


@dataclass(frozen=True)
class Record:
    """Hub angles (k, 2) [rad], and tip deflections (k, 2) [m] as recorded and unfiltered."""

    t: Array
    q: Array
    filtered: Array
    deflection: Array


def rig() -> dn.Robot:
    return dn.load_robot(URDF, gravity=(0, 0, 0))


def read(name: str) -> Record:
    data = scipy.io.loadmat(rig_run(f'{name}_run01'), squeeze_me=True)
    gains = np.array([sensor.gain for sensor in rig().tree.sensors])
    strain = gains * np.column_stack((data['theta12'], data['X2_sim'][:, 1]))
    strain -= strain[:50].mean(axis=0)  # the first 0.1 s stand still
    rate, second = (
        savgol_filter(strain, WINDOW, 4, order, STEP, axis=0) / OMEGA**order for order in (1, 2)
    )
    smooth = savgol_filter(strain, WINDOW, 4, axis=0)
    hubs = np.column_stack((data['theta11'], data['X2_sim'][:, 0]))
    return Record(data['time'], hubs, strain, smooth + 2.0 * DAMPING * rate + second)


def behind_filter(t: Array, deflection: Array) -> Array:
    filtering = TransferFunction([OMEGA**2], [1.0, 2.0 * DAMPING * OMEGA, OMEGA**2])
    return np.column_stack([lsim(filtering, column, t)[1] for column in deflection.T])


def estimate(record: Record, fused: Sequence[int] = ()) -> Array:
    """Deflections of both tips (k, 2) from hub angles and some of the gauges."""
    # Link 2 bends 1.7 times as much as the recorded inertias let it.
    fusion = FusionSettings(model_error=0.7) if fused else None
    observer = Observer(rig(), ObserverSettings(step=STEP, fusion=fusion))
    found = []
    for k, t in enumerate(record.t):
        observer.measure(t, record.q[k])
        for place in fused:
            observer.sense(place, t, float(record.deflection[k, place]))
        observer.tick(t)
        found.append(observer.deflections.evaluate(observer.q, observer.qd)[0][[1, 7]].copy())
    return np.array(found)


def rms(got: Array, measured: Array) -> Array:
    """Rms errors as shares of the peaks (2,)."""
    error = np.sqrt(np.mean((got - measured) ** 2, axis=0))
    return np.asarray(error / np.abs(measured).max(axis=0))


def test_ring_of_the_model_is_the_rig_s() -> None:
    robot = rig()
    zero = np.zeros(robot.n)
    assert 1.79 < robot.natural_frequencies(zero)[0] < 1.85
    # J12 about joint 1, beside the hub
    assert robot.inertia_matrix(zero)[0, 0] - 0.06353616 == pytest.approx(0.170434272, rel=2e-3)


def test_second_stage_is_recorded_as_it_was_measured() -> None:
    stored = scipy.io.loadmat(LONG_RECORD, squeeze_me=True)
    for column, name in enumerate(('theta21_deg', 'theta22_deg')):
        assert np.ptp(stored[name]) > 2.0
        simulated = np.degrees(stored['X2_sim'][:, column])
        np.testing.assert_allclose(simulated, stored[name], rtol=0.0, atol=1e-12)


def test_rig_has_the_numbers_that_are_stored_with_its_records() -> None:
    stored = scipy.io.loadmat(LONG_RECORD, squeeze_me=True)
    block = ElementTree.parse(URDF).getroot().find('flexibility')
    assert block is not None
    beams, actuators = block.findall('beam'), block.findall('actuator')
    for stage, beam, actuator in zip('12', beams, actuators, strict=True):
        length, bending = stored[f'L{stage}'], beam.find('bending')
        assert bending is not None
        assert float(beam.attrib['length']) == length
        # the stored spring stands at the root for a cantilever that a force at its tip bends
        ei = stored[f'Ks{stage}'] * length / 3.0
        assert float(bending.attrib['ei']) == pytest.approx(ei, rel=1e-5)
        assert float(actuator.attrib['armature']) == stored[f'J{stage}1']
    assert (stored['wcfa'], stored['zetaf']) == (OMEGA, DAMPING)


# As measured, rounded up: link 2 bends 1.7 times as much as the recorded inertias let it.
@pytest.mark.parametrize(
    ('name', 'bounds', 'correlation'),
    [('30deg', (0.10, 0.19), 0.96), ('10deg', (0.16, 0.16), 0.85)],
)
def test_hub_angles_alone(name: str, bounds: tuple[float, float], correlation: float) -> None:
    record = read(name)
    found = estimate(record)
    assert (rms(found, record.deflection) < bounds).all()
    filtered = behind_filter(record.t, found)
    for got, measured in zip(filtered.T, record.filtered.T, strict=True):
        assert np.corrcoef(got, measured)[0, 1] > correlation


@pytest.mark.parametrize('name', ['30deg', 'neg_20deg'])
def test_gauge_of_link_1_helps_link_2(name: str) -> None:
    record = read(name)
    alone = rms(estimate(record), record.deflection)
    first = rms(estimate(record, [0]), record.deflection)
    assert first[0] < 0.01
    assert first[1] < 0.8 * alone[1]


def test_gauge_of_link_2_does_not_help_link_1() -> None:
    record = read('30deg')
    second = rms(estimate(record, [1]), record.deflection)
    assert second[1] < 0.01
    # what link 2 bends too much is no load on link 1
    assert second[0] < 0.13
    assert (rms(estimate(record, [0, 1]), record.deflection) < 0.01).all()
