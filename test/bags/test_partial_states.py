"""Joint states of several publishers: joined by joint, at the stamps of those with most joints."""

from pathlib import Path

import numpy as np
import pytest

from denoc_ros.bags.joint_state import JOINT_STATE
from denoc_ros.bags.run import read_run
from denoc_ros.bags.series import JointSeries, joint_state_blocks, read_joint_states
from denoc_ros.bags.writer import BagWriter

SECOND = 10**9
ARM = ('elbow', 'shoulder')
PERIOD = 0.004


def arm(t: float) -> list[float]:
    return [np.sin(t), np.cos(t)]


def finger(t: float) -> float:
    return 0.3 * t


def two_publishers(
    path: Path, rows: int = 500, every: int = 10, without: tuple[int, int] = (0, 0)
) -> Path:
    """Write an arm's states, and those of a finger after each so many; rows without the finger."""
    with BagWriter(path) as bag:
        bag.add_topic('/joint_states', JOINT_STATE)
        for k in range(rows):
            t = k * PERIOD
            at = SECOND + round(t * SECOND)
            bag.write_message(
                '/joint_states', at, name=list(ARM), position=arm(t), effort=[1.0, 2.0 * t]
            )
            if k % every == 0 and not without[0] <= k < without[1]:
                late = at + 700_000
                position = [finger(t + 7e-4)]
                bag.write_message('/joint_states', late, name=['finger'], position=position)
    return path


def require_joined(found: JointSeries, rows: int = 500) -> None:
    assert found.names == (*ARM, 'finger')
    t = PERIOD * np.arange(rows)
    np.testing.assert_allclose(found.stamp_ns, SECOND + np.rint(t * SECOND))
    np.testing.assert_allclose(found.position[:, :2], np.array([arm(x) for x in t]))
    # linear between its messages; held before the first and after the last
    inside = (t >= 7e-4) & (t <= t[-10])
    np.testing.assert_allclose(found.position[inside, 2], finger(t[inside]), atol=1e-9)
    assert np.isfinite(found.position).all()
    assert np.isnan(found.effort[:, 2]).all()


def test_joints_of_other_messages_are_interpolated_at_the_stamps_of_most(tmp_path: Path) -> None:
    path = two_publishers(tmp_path / 'a.mcap')
    require_joined(read_joint_states(path))
    require_joined(read_run(path).joint_states['/joint_states'])


@pytest.mark.parametrize('rows', [7, 23, 100, 549])
def test_the_size_of_a_block_does_not_matter(tmp_path: Path, rows: int) -> None:
    path = two_publishers(tmp_path / 'a.mcap', without=(200, 400))
    whole = read_joint_states(path)
    joined = None
    for block in joint_state_blocks(path, ['/joint_states'], rows):
        series = block['/joint_states']
        joined = series if joined is None else joined.followed_by(series)
    assert joined is not None
    np.testing.assert_array_equal(joined.stamp_ns, whole.stamp_ns)
    for field in ('position', 'effort'):
        ours, all_at_once = (getattr(each.select(whole.names), field) for each in (joined, whole))
        if field == 'position':  # a gap is seen by a block that shows the usual period
            kept = np.isfinite(ours).all(axis=1) & np.isfinite(all_at_once).all(axis=1)
            assert np.count_nonzero(~kept) <= 215
            ours, all_at_once = ours[kept], all_at_once[kept]
        np.testing.assert_allclose(ours, all_at_once, atol=1e-12)


def test_a_joint_is_not_known_where_its_messages_are_far_apart(tmp_path: Path) -> None:
    found = read_joint_states(two_publishers(tmp_path / 'a.mcap', without=(200, 400)))
    missing = np.flatnonzero(np.isnan(found.position[:, 2]))
    assert missing[0] == 191
    assert missing[-1] == 400
    assert len(missing) == 210


def test_nothing_is_between_two_sides_of_a_turn(tmp_path: Path) -> None:
    path = tmp_path / 'a.mcap'
    with BagWriter(path) as bag:
        bag.add_topic('/joint_states', JOINT_STATE)
        for k in range(100):
            at = SECOND + k * 10**7
            bag.write_message('/joint_states', at, name=list(ARM), position=[0.0, 0.0])
            if k % 5 == 0:
                angle = (0.1 * k + np.pi) % (2.0 * np.pi) - np.pi
                bag.write_message('/joint_states', at, name=['wheel'], position=[angle])
    wheel = read_joint_states(path).position[:, 2]
    turned = np.exp(1j * wheel) * np.exp(-0.1j * np.arange(100))
    assert np.abs(np.angle(turned)).max() < 0.5


def test_messages_beside_others_that_name_all_joints_stay(tmp_path: Path) -> None:
    path = tmp_path / 'a.mcap'
    with BagWriter(path) as bag:
        bag.add_topic('/joint_states', JOINT_STATE)
        for k in range(10):
            names = list(ARM) if k % 3 else ['elbow']
            bag.write_message('/joint_states', SECOND + k, name=names, position=[0.1] * len(names))
    found = read_joint_states(path)
    assert np.isnan(found.position[::3, 1]).all()
    assert len(found.t) == 10
