"""Windows that hold an impact or a motion: what is no free decay is not called good."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from denoc_ros.bags.writer import BagWriter
from denoc_ros.identification.decay import analysis
from denoc_ros.identification.decay.analysis import analyse_decay
from denoc_ros.identification.decay.channel import Channel, read_record
from denoc_ros.identification.decay.components import find_lines, later_start_differs, suspects
from denoc_ros.identification.decay.damped import Damped, fit_damped
from denoc_ros.identification.decay.modes_fit import fit_modes
from denoc_ros.identification.decay.record_segments import (
    decay_window,
    moving_until,
    standing_spans,
)
from denoc_ros.identification.decay.records import Record

Floats = NDArray[np.float64]
RATE, SECONDS = 250.0, 2.5
T = np.arange(0.0, SECONDS, 1.0 / RATE)
MODES = ((4.3, 0.006, 1.0), (26.0, 0.01, 0.5))  # frequency [Hz], damping ratio, gain


def response(force: Floats) -> Floats:
    """Return what two modes answer to a force, with noise at 50 dB."""
    y = np.zeros(T.size)
    for frequency, zeta, gain in MODES:
        rate = 2.0 * np.pi * frequency
        damped = rate * np.sqrt(1.0 - zeta**2)
        impulse = np.exp(-zeta * rate * T) * np.sin(damped * T) / damped
        y += gain * np.convolve(force, impulse)[: T.size] / RATE
    noise = 3e-3 * np.abs(y).max() * np.random.default_rng(1).standard_normal(T.size)
    return np.asarray(y + noise)


def hammer(at: float, width: float) -> Floats:
    inside = (at < T) & (at + width > T)
    return np.where(inside, np.sin(np.pi * (T - at) / width) ** 2 / width, 0.0)


def motion(start: float, duration: float) -> tuple[Floats, Floats]:
    """Return position and acceleration of a rest-to-rest motion by one."""
    s = np.clip((T - start) / duration, 0.0, 1.0)
    acceleration = (60.0 * s - 180.0 * s**2 + 120.0 * s**3) / duration**2
    return 10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5, acceleration


@pytest.mark.parametrize(
    ('force', 'begin'),
    [
        (hammer(0.5, 0.008), 0.485),
        (hammer(0.5, 0.02), 0.49),
        (motion(0.2, 0.4)[1], 0.25),
        (motion(0.2, 0.4)[1], 0.45),
    ],
)
def test_impact_or_motion_in_the_window_is_no_good_mode(force: Floats, begin: float) -> None:
    modes = fit_modes(Record(T, response(force)).part(begin, SECONDS))
    # what is called good is a mode of the structure
    for k, verdict in enumerate(modes.verdict):
        off = min(abs(modes.frequency[k] / frequency - 1.0) for frequency, _, _ in MODES)
        assert verdict != 'good' or off < 0.01, f'{modes.frequency[k]:.4g} Hz {modes.reasons[k]}'


@pytest.mark.parametrize(('zeta', 'verdict'), [(0.2, 'good'), (0.35, 'doubtful')])
def test_a_decay_of_one_cycle_may_be_the_end_of_a_motion(zeta: float, verdict: str) -> None:
    rate = 2.0 * np.pi * 1.2
    y = np.exp(-zeta * rate * T) * np.cos(rate * np.sqrt(1.0 - zeta**2) * T)
    modes = fit_modes(Record(T, y + 1e-3 * np.random.default_rng(6).standard_normal(T.size)))
    assert modes.verdict == (verdict,), modes.reasons


def test_component_of_an_impact_is_not_found_by_a_later_start() -> None:
    t = np.arange(0.0, 2.0, 0.001)
    noise = 1e-3 * np.random.default_rng(4).standard_normal(t.size)
    light, heavy = (0.2, 27.0), (35.0, 160.0)  # decay rate [1/s], damped frequency [rad/s]
    starts = np.array([light, heavy])

    def decay(sigma: float, omega: float) -> Floats:
        return np.asarray(np.exp(-sigma * t) * np.cos(omega * t))

    true = fit_damped(t, decay(*light) + decay(*heavy) + noise, starts)
    assert later_start_differs(t, true, 2.0, 1) == ''
    bump = np.exp(-(((t - 0.012) / 0.006) ** 2))
    made_up = fit_damped(t, decay(*light) + bump + noise, starts)
    reason = later_start_differs(t, made_up, 2.0, 1)
    assert 'no free decay from the start of the window' in reason
    assert later_start_differs(t, made_up, 2.0, 0) == ''


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Bag of a joint that moves from 0.4 to 0.9 s, and of the tip that rings from then on."""
    path = tmp_path_factory.mktemp('stop') / 'stop.mcap'
    position, acceleration = motion(0.4, 0.5)
    tip = response(-acceleration)
    with BagWriter(path) as writer:
        for topic in ('/joint_states', '/tip'):
            writer.add_topic(topic, 'sensor_msgs/msg/JointState')
        draw = np.random.default_rng(3)
        for k, t in enumerate(T):
            stamp = 10**18 + round(t * 1e9)
            header = {'stamp': {'sec': stamp // 10**9, 'nanosec': stamp % 10**9}}
            joints = [position[k] + 1e-5 * draw.standard_normal(), 1e-5 * draw.standard_normal()]
            writer.write_message(
                '/joint_states', stamp, header=header, name=['a', 'b'], position=joints
            )
            writer.write_message('/tip', stamp, header=header, name=['uy'], position=[tip[k]])
    return path


def test_window_begins_when_the_joints_stop(bag: Path) -> None:
    reading = read_record(bag, Channel('/tip', 'uy'))
    standing = standing_spans(reading)
    assert [span[0] < 0.01 or 0.8 < span[0] < 0.92 for span in standing] == [True, True]
    record, chosen_by = decay_window(reading.record, standing)
    assert chosen_by == 'found where the joints stand'
    # the joint is slower than 2 % of its largest speed for its last 50 ms
    assert 0.84 < record.t[0] < 0.92
    found = analyse_decay(reading.record, standing=standing).modes
    main = int(np.argmax(found.energy))
    assert found.frequency[main] == pytest.approx(4.3, rel=2e-3)
    assert found.damping_ratio[main] == pytest.approx(0.006, rel=0.1)
    # the joints' own motion is no ring of theirs
    assert standing_spans(read_record(bag, Channel('/joint_states', 'a'))) == []


def test_given_window_in_which_the_joints_move_is_doubted(bag: Path) -> None:
    channel = Channel('/tip', 'uy', begin=0.6)
    reading = read_record(bag, channel)
    standing = standing_spans(reading)
    found = analyse_decay(reading.record, True, standing).modes
    assert 'good' not in found.verdict
    assert all(any('joints move until' in one for one in some) for some in found.reasons)
    assert moving_until(read_record(bag, Channel('/tip', 'uy', begin=1.0)).record, standing) == 0.0


def test_lines_are_not_named_by_a_tolerance_that_grows() -> None:
    t = np.linspace(0.0, 8.0, 400)
    poles = np.array([[2.0, 2.0 * np.pi * 0.3951], [8.0, 2.0 * np.pi * 1.75]])
    residual = 0.01 * np.sin(3.0 * t)  # hangs together: it widens the tolerance by the decay
    fit = Damped(
        poles, np.array([1.0, 0.0, 0.05, 0.0, 0.0, 0.0]), residual, np.ones((400, 4)), 8.0
    )
    assert find_lines(fit, 8.0) == {}
    assert suspects(fit, 8.0) == {}


LONG_T = np.arange(12_000.0) / 3000.0


@pytest.fixture
def short_is_long(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let records of 10,000 samples be long: the fits to larger ones take their time."""
    monkeypatch.setattr(analysis, 'LONG', 10_000)
    monkeypatch.setattr(analysis, 'FIRST_LOOK', 2_000)


def long_record(kind: str) -> Record:
    """Return a record longer than one that is fitted as a whole at once."""
    random = np.random.default_rng(2)
    if kind == 'tones':  # a machine at constant speed
        tones = zip(random.uniform(10.0, 1300.0, 20), random.uniform(0.2, 1.0, 20), strict=True)
        y = sum(size * np.sin(2.0 * np.pi * hertz * LONG_T) for hertz, size in tones)
    elif kind == 'slow tones':  # the same of a slow one: its samples are close
        tones = zip(random.uniform(2.0, 60.0, 20), random.uniform(0.2, 1.0, 20), strict=True)
        y = sum(size * np.sin(2.0 * np.pi * hertz * LONG_T) for hertz, size in tones)
    elif kind == 'run down':  # the same while it stops
        turns = 2.0 * np.pi * (24.0 * LONG_T - 1.5 * LONG_T**2)
        y = sum(size * np.sin(k * turns + k) for k, size in enumerate(random.uniform(0.2, 1, 20)))
        y = y * np.exp(-0.3 * LONG_T)
    elif kind == 'decay':
        y = np.exp(-0.2 * LONG_T) * np.cos(2.0 * np.pi * 21.0 * LONG_T)
    elif kind == 'drift':  # a decay that is small beside the drift of its sensor
        y = 0.2 * np.exp(-0.2 * LONG_T) * np.cos(2.0 * np.pi * 21.0 * LONG_T)
        y = y + 3.0 * np.sin(1.4 * LONG_T) ** 3
    else:  # 'steady': one mode that hardly decays
        y = np.exp(-0.001 * LONG_T) * np.cos(2.0 * np.pi * 21.0 * LONG_T)
    return Record(LONG_T, np.asarray(y) + 0.01 * random.standard_normal(LONG_T.size), kind)


@pytest.mark.usefixtures('short_is_long')
@pytest.mark.parametrize('kind', ['tones', 'slow tones', 'run down'])
def test_a_long_record_that_is_no_free_decay_is_told_by_its_beginning(kind: str) -> None:
    """A fit to all samples says the same after minutes."""
    found = analyse_decay(long_record(kind), given=True)
    assert found.record.t.size <= 2_000
    assert set(found.modes.verdict) <= {'not identifiable'}
    assert any('no free decay: ' in remark and '%' in remark for remark in found.modes.remarks)


@pytest.mark.usefixtures('short_is_long')
@pytest.mark.parametrize('kind', ['decay', 'drift', 'steady'])
def test_a_long_free_decay_is_fitted_as_a_whole(kind: str) -> None:
    """What damped cosines explain is fitted whole, though it hardly falls."""
    record = long_record(kind)
    found = analyse_decay(record, given=True)
    np.testing.assert_array_equal(found.record.t, record.t)
    expected = fit_modes(record)
    np.testing.assert_array_equal(found.modes.damping_ratio, expected.damping_ratio)
    np.testing.assert_array_equal(found.modes.frequency, expected.frequency)
    rate = {'decay': 0.2, 'drift': 0.2, 'steady': 0.001}[kind]
    k = int(np.argmin(np.abs(found.modes.frequency - 21.0)))
    zeta = rate / np.hypot(rate, 2.0 * np.pi * 21.0)
    assert found.modes.interval[k, 0] < zeta < found.modes.interval[k, 1]
