"""Faults of what comes in: joint states, references, parameters, other networks."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

import numpy as np
from trust import references, states
from trust.outcome import Outcome, judge_torques, torque_text
from trust.stage import INPUTS, POSTURE, RECOVERY, Stage

FELT = 0.3  # s: until inputs are stale, and until the torque has come back
SETTLING = 0.03  # s until what was said before has been heard
FOLLOWED = 0.8  # share of the messages: the rest is for the machine's own pauses


@dataclass(frozen=True)
class Fault:
    """Something that goes wrong for a while.

    Attributes
    ----------
    name, sent : str
        The first two columns of the table.
    applied : callable
        Gives a context in which it goes wrong.
    causes : tuple of str
        `topic cause` of what /diagnostics must count.
    safe : bool or None
        Whether the safe command must take over; False: the reference must be followed throughout;
        None: either.
    reset : bool
        Whether it takes ~/reset to go on.
    off : float
        How far from POSTURE [rad] the robot says it is.
    prepare : callable
        Done before.
    """

    name: str
    sent: str
    applied: Callable[[Stage], AbstractContextManager[Any]]
    causes: tuple[str, ...] = ()
    safe: bool | None = False
    reset: bool = False
    off: float = 0.0
    prepare: Callable[[Stage], None] = lambda stage: None


def run_fault(stage: Stage, fault: Fault, seconds: float, exact: bool) -> Outcome:
    """Let a fault happen for a while; return what came of it.

    Parameters
    ----------
    stage, fault : Stage, Fault
    seconds : float
    exact : bool
        Whether to wait for the counts of the whole fault, else for the first of each cause.
    """
    outcome = Outcome(fault.name, fault.sent)
    stage.follow()
    fault.prepare(stage)
    time.sleep(SETTLING)
    keys = [f'{topic} rejected {cause}' for topic, cause in map(str.split, fault.causes)]
    before = {key: stage.count(INPUTS, key) for key in keys}
    counts = f'{fault.name}: counts on /diagnostics of {fault.causes}'
    begin = time.time()

    def is_counted() -> bool:
        return all(stage.count(INPUTS, key) > before[key] for key in keys)

    with fault.applied(stage):
        time.sleep(seconds)
        if not exact:  # a busy machine may have sent nothing of it yet
            stage.until(is_counted, RECOVERY, counts)
        if fault.safe:
            outcome.require(stage.is_safe(), 'the safe command must take over')
        end = time.time()
    if fault.reset:
        time.sleep(0.2)
        outcome.require(not stage.following(), 'nothing but ~/reset may end it')
        stage.reset()
    stage.planner = lambda: ()
    stage.follow()
    if exact:
        heard = time.time()
        stage.until(lambda: stage.heard_at(INPUTS) >= heard and is_counted(), RECOVERY, counts)
    torques = stage.torques(begin, time.time())
    judge_torques(outcome, torques)
    inside = (torques.stamp >= begin) & (torques.stamp <= end)
    lost = ~torques.following
    outcome.require(
        (np.abs(torques.position[lost] - POSTURE) <= fault.off + 1e-9).all(),
        'torque must be for the reference or for where the robot stands, nowhere else',
    )
    if fault.safe is False and not stage.absence(begin - FELT, end):
        share = float(torques.following[inside].mean())
        outcome.require(share > FOLLOWED, f'the reference must be followed, was in {share:.2f}')
    outcome.torque = torque_text(torques, begin, end)
    if fault.reset:
        outcome.torque += ', after ~/reset'
    outcome.diagnostics = _said(stage, keys, before, begin)
    counted = sum(stage.count(INPUTS, key) - before[key] for key in keys)
    outcome.lost = f'{counted} messages refused' if counted else 'nothing'
    return outcome


def _said(stage: Stage, keys: Sequence[str], before: dict[str, int], since: float) -> str:
    said = [f'{key.split()[-1]} {stage.count(INPUTS, key) - before[key]}' for key in keys]
    statuses = stage.statuses('feedforward: torque', since)
    stale = {s.message for s in statuses if s.message.startswith(('stale', 'torque'))}
    return ', '.join([*said, *sorted(stale)]) or 'ok'


FAULTS = (
    Fault(
        'not finite',
        'NaN and infinite positions, infinite rates and efforts',
        states.instead(states.not_finite),
        ('joint_states non_finite',),
        safe=True,
    ),
    Fault(
        'wrong length',
        'too few or too many positions, rates, efforts',
        states.instead(states.wrong_length),
        ('joint_states wrong_length',),
        safe=True,
    ),
    Fault(
        'wrong joints',
        'unknown, missing and repeated joints',
        states.instead(states.wrong_joints),
        (
            'joint_states unknown_joint',
            'joint_states missing_joint',
            'joint_states repeated_joint',
        ),
        safe=True,
    ),
    Fault(
        'no message at all',
        'bytes cut off or random',
        states.instead(states.bytes_of_nothing),
        ('joint_states malformed',),
        safe=True,
    ),
    Fault(
        'shuffled order',
        'good joint states, joints in another order',
        states.instead(states.shuffled),
    ),
    Fault(
        'stamps going back',
        'joint states 10 s old',
        states.instead(states.backwards),
        ('joint_states backwards_stamp',),
        safe=True,
    ),
    Fault(
        'duplicates',
        'one joint state again and again',
        states.duplicates,
        ('joint_states duplicate',),
        safe=True,
    ),
    Fault(
        'second robot',
        'another publisher of joint states elsewhere',
        states.second_publisher,
        ('joint_states second_publisher',),
        safe=True,
    ),
    Fault('flood', 'good joint states at 10 kHz', states.flood),
    Fault(
        'flood of garbage',
        'NaN at 10 kHz, a good joint state in 50',
        states.garbage_flood,
        ('joint_states non_finite',),
        safe=None,
    ),
    Fault(
        'robot stops', 'no joint states', lambda stage: states.saying(stage, lambda: ()), safe=True
    ),
    Fault(
        'robot jumps',
        'positions 1 rad off, to and fro',
        states.instead(states.jumped),
        ('joint_states implausible',),
        safe=None,
        off=1.0,
    ),
    Fault(
        'robot restarts',
        'no joint states, then those of a new publisher',
        states.restarted,
        safe=True,
    ),
    Fault(
        'stamp from the future',
        'one joint state 1000 s ahead, then good ones',
        states.from_the_future,
        safe=None,
    ),
    Fault(
        'clock set back',
        'joint states of a clock 10 s behind from here on',
        states.clock_set_back,
        ('joint_states backwards_stamp',),
        safe=True,
        reset=True,
    ),
    Fault(
        'bad references',
        'not finite, wrong lengths and joints, times that stand still, bytes cut off',
        references.bad_references,
        (
            'reference non_finite',
            'reference wrong_length',
            'reference unknown_joint',
            'reference times_not_increasing',
            'reference malformed',
        ),
    ),
    Fault(
        'second planner',
        'two publishers of other references',
        references.second_planner,
        ('reference second_publisher',),
    ),
    Fault(
        'huge trajectory',
        f'one of {references.MANY_POINTS} points',
        references.many_points,
        safe=None,
    ),
    Fault(
        'stream starves',
        'a streamed reference that stops',
        lambda stage: references.planning(stage, lambda: ()),
        safe=True,
        prepare=references.stream,
    ),
    Fault(
        'out of reach',
        'streamed references of 1e200 rad',
        references.out_of_reach,
        ('reference out_of_range',),
    ),
    Fault(
        'violent reference',
        'streamed accelerations of 1e5 rad/s^2 and more',
        references.violent,
        safe=None,
        off=math.inf,
    ),
    Fault(
        'parameter abuse',
        f'{len(references.REFUSED)} bad values, 20 live changes of payload',
        references.parameter_abuse,
    ),
    Fault(
        'another domain',
        'NaN joint states by a process of another ROS domain',
        references.another_domain,
    ),
)
