"""Actions of `denoc identify`, with a line of help each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple


class ActionRow(NamedTuple):
    """Where an action of `denoc identify` is."""

    help: str
    # below identification: a verb's module, with an `Action` in `DECLARED`; else one with the
    # computation `identify_NAME`, whose arguments are the action's options
    module: str
    # in identification.pages: `NAME_page` and `NAME_text` of a computation, if it has its own
    pages: str = ''


RECORDS = 'verbs.identify_records'
RUN = 'verbs.identify_run'
MODEL, RESULTS = 'verbs.identify_model', 'verbs.identify_results'
ACTIONS = {
    'run': ActionRow('stiffness, payload and damping of the robot that a run recorded', RUN),
    'info': ActionRow(
        'rate, gaps, jitter, clipping, noise of the signals of a recording', RECORDS
    ),
    'segment': ActionRow('find releases, free decays, steps and rests in a signal', RECORDS),
    'modal': ActionRow(
        'modes and damping ratios of a free decay, or of a folder of them', RECORDS
    ),
    'joint': ActionRow(
        'viscous and Coulomb friction of a joint from a free swing',
        'joint.joint_swing',
        'identify_signals',
    ),
    'forced': ActionRow('modes from torque and response', RECORDS),
    'servo': ActionRow(
        'bandwidth, damping, delay and static gain of position-controlled joints', RECORDS
    ),
    'model': ActionRow(
        'stiffness, payload, inertia, friction, gains and delays of a whole robot', MODEL
    ),
    'excite': ActionRow(
        'plan the motion whose recording identifies numbers of a robot best', MODEL
    ),
    'apply': ActionRow("write identified damping into a robot's URDF", RESULTS),
    'compare': ActionRow('modes of several runs: mean, spread, repeatability', RESULTS),
    'postures': ActionRow('modes at several postures as a table for the shaper', RESULTS),
}

# options of `modal` by which a command without an action is one of a single signal
OF_A_SIGNAL = (
    *('--topic', '--field', '--quantity', '--gain', '--offset', '--unit', '--band', '--modes'),
    *('--at', '--joints', '--workers', '--scheduler', '--time', '--time-unit', '--rate'),
)
OF_A_RUN = ('--phase', '--free', '--apply')


def default_action(words: Sequence[str]) -> str:
    """Return the action of a command without one: a whole run, or a free decay of one signal.

    A run is a recording that holds the robot, or one for which a robot is given.
    """
    given = {word.partition('=')[0] for word in words}
    if given & {*OF_A_RUN}:
        return 'run'
    several = len(words) > 1 and not words[1].startswith('-')
    if several or given & {*OF_A_SIGNAL}:
        return 'modal'
    return 'run' if _holds_robot(Path(words[0])) else 'modal'


def _holds_robot(path: Path) -> bool:
    """Say whether a recording is that of a whole robot; one that cannot be read is not."""
    from denoc_ros.bags.reader import bag_topics, read_description
    from denoc_ros.errors import DenocError
    from denoc_ros.simulation.recorded.run_files import find_bag

    try:
        bag = find_bag(path)
        return bool(read_description(bag)) and '/joint_states' in bag_topics(bag)
    except DenocError:
        return False
