"""Actions of `denoc identify`, with a line of help each."""

from __future__ import annotations

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
MODEL, RESULTS = 'verbs.identify_model', 'verbs.identify_results'
ACTIONS = {
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

DEFAULT_ACTION = 'modal'
