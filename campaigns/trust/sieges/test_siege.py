"""The siege: its parts, and a minute of it."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from campaign_table import import_paths
from rcl_interfaces.msg import ParameterValue
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from trust.adversary import FLOATS, Adversary, leaves
from trust.assault import damage, jumps, kernel_files
from trust.attacks import (
    DAMAGES,
    OF_GAUGES,
    OF_SHAPERS,
    WEIGHTS,
    Inventory,
    Step,
    adversary,
    draw_step,
)
from trust.laws import Life, Span, TorqueLedger, slope, unexplained
from trust.mending import Mending
from trust.sieges.shrinking import shrink
from trust.sieges.siege import Failure, Round, kind_of, write_steps
from trust.sieges.siege_gauges import FAULTS, SPOILT, Gauges
from trust.sieges.siege_scenes import NODES, SCENES
from trust.sieges.siege_stage import PATIENCE, RECOVERY, own_kernels
from trust.witness import Witness

ROOT = Path(__file__).resolve().parents[3]
BOUND = 1200.0  # s: for a minute, new starts, and kernels to compile, on a slow machine
INVENTORY = Inventory(
    {node: {f'/{node}/get_state': 'lifecycle_msgs/srv/GetState'} for node in NODES},
    {node: {'/joint_states': 'sensor_msgs/msg/JointState'} for node in NODES},
    {node: {'model': ParameterValue(type=4, string_value='rigid')} for node in NODES},
    ['j1', 'j2', 'model'],
)


def draws(seed: int, count: int) -> list[Step]:
    rng = np.random.default_rng(seed)
    return [draw_step(rng, INVENTORY, ('plant',)) for _ in range(count)]


# ---- what is drawn


def test_a_seed_draws_the_same_steps_and_they_are_plain() -> None:
    steps = draws(3, 50)
    assert json.loads(json.dumps(steps)) == draws(3, 50) == steps
    assert draws(4, 50) != steps


def test_every_kind_of_attack_is_drawn_and_only_mortals_are_told_to_end() -> None:
    attacks = [attack for step in draws(0, 600) for attack in step]
    assert {attack['do'] for attack in attacks} == set(WEIGHTS)
    assert {attack['node'] for attack in attacks if attack['do'] == 'end'} == {'plant'}
    assert {name for a in attacks for name in a.get('signals', ())} == {'TERM', 'INT', 'HUP'}


def test_gauges_and_planners_are_attacked_where_there_are_some() -> None:
    rng = np.random.default_rng(0)
    inventory = replace(INVENTORY, has_gauges=True, has_shaper=True)
    attacks = [attack for _ in range(600) for attack in draw_step(rng, inventory, ('plant',))]
    drawn = {
        kind: [each for each in attacks if each['do'] == kind]
        for kind in (*OF_GAUGES, *OF_SHAPERS)
    }
    assert {attack['what'] for attack in drawn['gauges']} == set(FAULTS)
    killed = {(attack['node'], attack['child']) for attack in drawn['kill']}
    assert killed == {('shaper', True), ('shaper', False), ('feedforward', True)}
    halted = {(attack['node'], attack['then']) for attack in drawn['halt']}
    assert len(halted) == 6
    assert {attack['stop'] for attack in drawn['endless']} == {True, False}


def test_gauges_without_a_shaper_are_attacked_by_the_predictors_scenes() -> None:
    rng = np.random.default_rng(0)
    inventory = replace(INVENTORY, has_gauges=True)
    attacks = [attack for _ in range(300) for attack in draw_step(rng, inventory, ('plant',))]
    assert not {attack['do'] for attack in attacks} & set(OF_SHAPERS)
    gauges = [attack for attack in attacks if attack['do'] == 'gauges']
    assert {attack['node'] for attack in gauges} == {'predictor'}
    scenes = [scene for scene in SCENES.values() if scene.gauges and not scene.feeds_back]
    assert {scene.factor for scene in scenes} == {0.0, 1.0}
    for scene in scenes:
        assert {attack['what'] for attack in scene.first} == set(SPOILT)
        assert scene.parameters('predictor', Path())['strain'] == 'fuse'


def test_a_stop_on_the_way_is_attacked_alone_and_caches_with_an_end() -> None:
    steps = draws(0, 600)
    alone = [step for step in steps if any(attack['do'] == 'brake' for attack in step)]
    assert {len(step) for step in alone} == {1}
    attacks = [attack for step in steps for attack in step]
    stops = [attack for attack in attacks if attack['do'] == 'brake']
    assert {attack['how'] for attack in stops} == {'stop', 'cancel'}
    caches = [attack for attack in attacks if attack['do'] == 'cache']
    assert {attack['what'] for attack in caches} == set(DAMAGES)
    assert {attack['node'] for attack in caches} == {'plant'}


def reference(stamp: float, *points: tuple[float, float, float]) -> JointTrajectory:
    """Return a motion of one joint: rows of time, position and velocity."""
    message = JointTrajectory(joint_names=['j'])
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(round(1e9 * stamp), 10**9)
    for time, position, velocity in points:
        point = JointTrajectoryPoint(positions=[position], velocities=[velocity])
        point.accelerations = [0.0]
        point.time_from_start.nanosec = round(1e9 * time)
        message.points.append(point)
    return message


def test_references_that_jump_are_told_and_those_that_go_on_are_not() -> None:
    first = reference(10.0, (0.0, 0.0, 1.0), (0.8, 0.8, 1.0))
    goes_on = reference(10.5, (0.0, 0.5, 1.0), (0.3, 0.6, 0.0))
    assert jumps([first, goes_on, reference(11.0, (0.0, 0.6, 0.0), (0.5, 0.7, 0.0))]) == []
    (place,) = jumps([first, reference(10.5, (0.0, 0.4, 1.0), (0.3, 0.6, 0.0))])
    (rate,) = jumps([first, reference(10.5, (0.0, 0.5, 0.0), (0.3, 0.6, 0.0))])
    assert 'must go on where the one before is, got [0.4] [1.0] after [0.5' in place
    assert 'got [0.5] [0.0] after [0.5' in rate


@pytest.mark.parametrize('what', DAMAGES)
def test_kernels_are_damaged(what: str, tmp_path: Path) -> None:
    file = tmp_path / 'a.kernel'
    file.write_bytes(bytes(range(200)))
    damage(file, what, np.random.default_rng(0))
    assert not file.exists() if what == 'remove' else file.read_bytes() != bytes(range(200))


def test_what_is_damaged_are_kernels_of_the_stages_own(tmp_path: Path) -> None:
    files = kernel_files(own_kernels(tmp_path))
    assert all(file.is_relative_to(tmp_path) for file in files)
    assert any(file.name.startswith('inverse.inverse_dynamics-') for file in files)
    assert not any(file.name.startswith('articulated.forward_dynamics-') for file in files)


def test_gauges_fail_as_they_are_told_to() -> None:
    gauges, now = Gauges(['a', 'b']), 10**18

    def said(fault: str) -> list[JointState]:
        gauges.fault = fault
        return [message for _ in range(200) for message in gauges.messages(now)]

    def ages(fault: str) -> list[int]:
        stamps = [message.header.stamp for message in said(fault)]
        return [now - stamp.sec * 10**9 - stamp.nanosec for stamp in stamps]

    assert not said('silent')
    assert {tuple(message.name) for message in said('one silent')} == {('b',)}
    assert {value for message in said('wild') for value in message.position} >= {1e3}
    assert set(ages('late')) == {200_000_000}
    assert 20_000_000 < max(ages('jumpy')) < 50_000_000
    assert 100 < len(said('lost')) < 180
    assert set(ages('')) == {0}
    for fault in SPOILT:  # one of them, from then on
        gauges.fault = ''
        gauges.messages(now)
        gauges.fault = fault
        gauges.messages(now)
        later = [gauges.messages(now + 10**9)[0].position for _ in range(3)]
        assert [first for first, _ in later] == [0.0] * 3
        assert all(abs(last) > 1e-5 for _, last in later)
    assert not Gauges([]).messages(now)


def good() -> JointState:
    return JointState(name=['j1', 'j2'], position=[0.1, 0.2], effort=[0.0, 0.0])


def test_messages_have_all_that_nobody_should_send() -> None:
    numbers: list[float] = []
    counts: set[int] = set()
    words: set[int] = set()
    stamps, cut = [], 0
    for seed in range(600):
        sent = adversary(seed, INVENTORY, 'plant').sent('sensor_msgs/msg/JointState', good())
        if isinstance(sent, bytes):
            cut += 1
            continue
        assert deserialize_message(serialize_message(sent), JointState).name == sent.name
        numbers += [*sent.position, *sent.velocity, *sent.effort]
        counts.add(len(sent.position))
        stamps.append(sent.header.stamp)
        words.update(map(len, sent.name))
    assert cut > 30
    assert any(map(math.isnan, numbers))
    assert {math.inf, -math.inf} <= set(numbers)
    assert {x for x in FLOATS if x == x} <= set(numbers)
    assert any(x == 0.0 and math.copysign(1.0, x) < 0.0 for x in numbers)
    assert {0, 1, 2, 3, 300} <= counts
    assert any(stamp.nanosec >= 1_000_000_000 for stamp in stamps)
    assert any(stamp.sec < 0 for stamp in stamps)
    assert {0, 2, 1_000_000} <= words


def test_a_spoilt_message_keeps_something_of_the_good_one() -> None:
    for seed in range(100):
        message = good()
        Adversary(np.random.default_rng(seed)).spoil(message)
        pairs = list(zip(leaves(message), leaves(good()), strict=True))
        same = [getattr(o, name) == getattr(p, name) for (o, name, _), (p, _, _) in pairs]
        assert len(pairs) - 3 <= sum(same)


def test_requests_have_types_and_transitions_that_do_not_exist() -> None:
    drawn = [adversary(seed, INVENTORY, 'plant') for seed in range(300)]
    parameters = [each.message('rcl_interfaces/Parameter') for each in drawn]
    assert {77, 255} <= {parameter.value.type for parameter in parameters}
    assert 'model' in {parameter.name for parameter in parameters}
    assert {0, 1, 4, 99} <= {each.message('lifecycle_msgs/Transition').id for each in drawn}


# ---- the laws


def ledger() -> TorqueLedger:
    return TorqueLedger(np.array([10.0, 5.0]), 1.0, 500.0)


@pytest.mark.parametrize(
    ('effort', 'says'),
    [
        ([math.nan, 0.0], 'finite'),
        ([0.0, -math.inf], 'finite'),
        ([0.5, 5.1], 'within'),
        ([1.5, 0.0], 'per tick'),
        ([0.5, 0.5, 0.5], 'finite'),
    ],
)
def test_unlawful_torque_is_seen(effort: list[float], says: str) -> None:
    held = ledger()
    held.take(0, 1, np.zeros(2))
    held.take(2_000_000, 2, np.array(effort))
    told = held.told()
    assert any(says in law for law in told), told
    assert not held.told()


def test_lawful_torque_and_one_that_may_begin_anew_break_nothing() -> None:
    held = ledger()
    held.take(0, 1, np.zeros(2))
    held.take(2_000_000, 2, np.array([1.0, -1.0]))
    held.take(8_000_000, 5, np.array([4.0, -4.0]))  # two messages were lost
    held.anew.append(Span(9_000_000))
    held.take(10_000_000, 6, np.array([0.0, 0.0]))
    held.take(12_000_000, 1, np.array([9.0, 0.0]))  # another publisher's first
    assert not held.told()
    assert held.largest_delta == 1.0
    assert held.pauses == [Span(2_000_000, 8_000_000)]


def test_a_pause_is_excused_by_the_systems_absence_only() -> None:
    pause = Span(0, 10_000_000)
    assert unexplained(pause, 0.004, 0.0)
    assert unexplained(pause, 0.004, 0.005)
    assert not unexplained(pause, 0.004, 0.006)


def test_in_simulated_time_each_period_has_its_torque_and_the_clock_may_stand_between() -> None:
    held, still = ledger(), np.zeros(2)
    held.lull, held.clock_set = 0.01, [Span(50_000_000, 82_000_000)]
    for number, moment in enumerate([0, 2, 4, 8, 900, 10, 12], start=1):  # ms; set ahead, back
        held.take(12_000_000 * number, number, still, 1_000_000 * moment)
    (law,) = held.told()
    assert 'each period of simulated time must have its torque, got 2' in law
    assert not held.pauses
    held.take(12_000_000 * 9, 8, still, 14_000_000)
    assert [pause.seconds for pause in held.pauses] == pytest.approx([0.024])


def life(memory: Callable[[float], float], files: Callable[[float], int]) -> Life:
    told = Life('plant', 1)
    for second in range(600):
        told.at.append(float(second))
        told.memory.append(memory(second))
        told.files.append(files(second))
    return told


def test_growing_memory_and_descriptors_are_seen_after_the_warm_up() -> None:
    noise = np.random.default_rng(0).normal(0.0, 1e5, 600)
    flat = life(lambda t: 2e8 + 1e8 * (t > 60.0) + noise[int(t)], lambda t: 20)
    assert not flat.judge()
    at, memory, _ = flat.settled()
    assert abs(3600.0 * slope(at, memory)) < 1e6
    growing = life(lambda t: 2e8 + 1e5 * t + noise[int(t)], lambda t: 20 + int(t / 20.0))
    told = growing.judge()
    assert any('memory must stay' in law for law in told)
    assert any('descriptors must stay' in law for law in told)


def witness(folder: Path) -> Witness:
    """Return a witness that nobody has told of any torque, but its meters have spoken."""
    told = object.__new__(Witness)
    told.efforts, told.commands = ledger(), ledger()
    told.lives, told.pauses = {}, []
    told._folder, told._slack, told._most = folder, 0.0, 4e-3
    told._excused, told._waits, told._bare = [], [], []
    told._offsets, told._measured = {}, {'bare': 0, 'meter': 0}
    told._lock = threading.Lock()
    return told


def test_a_pause_is_judged_when_the_meters_have_spoken_of_its_time(tmp_path: Path) -> None:
    told, second = witness(tmp_path), 1_000_000_000
    own, bare, others, excused = (Span(k * second, k * second + 20_000_000) for k in range(1, 5))
    told.efforts.pauses = [own, bare, others, excused]
    told.excuse(excused.begin, excused.end)
    told._read()
    assert not told._judge_pauses(final=False)
    assert len(told.efforts.pauses) == 4
    (tmp_path / 'bare').write_text(f'{bare.begin} {bare.end}\n{9 * second} {9 * second}\n')
    (tmp_path / 'meter').write_text(
        f'w {others.begin} {others.end} recorder 0.019\nh 9.0 stage 1 1000000 3\nh 9.5 sta'
    )
    told._read()
    (law,) = told._judge_pauses(final=False)
    assert f'20.0 ms at {own.begin}' in law
    assert not told.efforts.pauses
    assert told.pauses_told()['number'] == 3
    assert told.pauses_told()['longer_than_bare_or_own_absence'] == 2
    assert told.lives[1].files == [3]


def test_what_explains_a_pause_is_kept_until_it_is_judged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told, second = witness(tmp_path), 1_000_000_000
    pause, excused = (Span(k * second, k * second + 20_000_000) for k in (1, 2))
    told.efforts.pauses = [pause, excused]
    told.excuse(excused.begin, excused.end)
    (tmp_path / 'bare').write_text(f'{pause.begin} {pause.end}\n')
    told._read()
    monkeypatch.setattr('trust.witness.time.time_ns', lambda: 200 * second)
    told.settle()  # mending took three minutes
    told._measured = {'bare': 200 * second, 'meter': 200 * second}
    assert not told._judge_pauses(final=False)
    assert not told.efforts.pauses
    told.settle()
    assert not told._bare
    assert not told._excused


def test_torque_that_catches_up_with_a_clock_that_was_set_does_not_follow_yet(
    tmp_path: Path,
) -> None:
    told, second = witness(tmp_path), 1_000_000_000
    told._goal, told._position, told._at = (0.0, 0.0), np.zeros(2), perf_counter()
    told._is_simulated, told._tick_ns = True, 4 * second
    assert told.following(4 * second)
    assert not told.following(1064 * second)


# ---- mending


def test_a_node_that_is_started_anew_has_the_time_of_a_start() -> None:
    patience, states = [], iter(['finalized', 'active'])
    process = SimpleNamespace(poll=lambda: None, terminate=lambda: None, returncode=0)
    stage = SimpleNamespace(up={'viewer'}, process=lambda node: process, comes=lambda *_: True)
    stage.witness = SimpleNamespace(excuse_anew=lambda: None)
    stage.start = stage.up.discard

    def lifecycle(node: str, timeout: float) -> str:
        patience.append(timeout)
        return next(states)

    stage.lifecycle = lifecycle
    Mending(cast(Any, stage), cast(Any, SimpleNamespace(inventory=None)))._active('viewer')
    assert patience == [RECOVERY, PATIENCE]
    assert stage.up == {'viewer'}


# ---- shrinking


@pytest.mark.parametrize('needed', [{7}, {3, 40}, {0, 1, 2}, {0, 63}])
def test_what_fails_is_shrunk_to_what_it_takes(needed: set[int]) -> None:
    tries: list[list[int]] = []

    def fails(steps: list[int]) -> bool:
        tries.append(steps)
        return needed <= set(steps)

    assert shrink(list(range(64)), fails, 60.0) == sorted(needed)
    assert len(tries) < 120


def test_what_does_not_fail_again_or_in_time_is_not_shrunk() -> None:
    assert shrink([1, 2, 3], lambda steps: False, 60.0) is None
    assert shrink([1, 2, 3], lambda steps: True, 0.0) is None


def test_steps_are_written_as_they_are_read(tmp_path: Path) -> None:
    steps = draws(5, 3)
    write_steps(tmp_path / 'f.json', Round('links', 5, failures=[Failure('law', 2)]), steps)
    assert json.loads((tmp_path / 'f.json').read_text()) == {
        'scene': 'links',
        'seed': 5,
        'steps': steps,
    }
    assert kind_of('torque must be finite, got [nan]') == kind_of('torque must be finite, got [2]')


# ---- all of it


@pytest.mark.ros
@pytest.mark.alone
def test_a_minute_of_siege_breaks_no_law(tmp_path: Path) -> None:
    """The same steps each time: `python -m campaigns siege` draws new ones for an hour."""
    told = tmp_path / 'told.json'
    # the last of a whole minute's steps would take as long as all others
    command = [sys.executable, '-m', 'trust.sieges.siege', '--minutes', '0.9', '--scene', 'links']
    command += ['--seed', '4', '--slack', '1', '--shrink', '0', '--json', str(told)]
    command += ['--failed', str(tmp_path / 'failed.json')]
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join(import_paths())}
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=BOUND
    )
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]
    (found,) = json.loads(told.read_text())
    assert found['seconds'] > 50.0
    assert found['torques'] > 100.0 * found['seconds']
    assert sum(sum(kinds.values()) for kinds in found['sent'].values()) > 100
