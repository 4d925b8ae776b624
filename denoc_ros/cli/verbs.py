"""Verbs of `denoc` and actions of `denoc identify`, with a line of help each; exit statuses."""

from __future__ import annotations

from typing import NamedTuple

VERBS = {
    'check': 'validate a robot; list its links, joints, beams, frequencies and masses',
    'simulate': 'simulate a robot through a scenario, without a ROS graph',
    'shape': 'plan a motion without residual vibration, with the tip on its path',
    'up': 'start the nodes, run a reference, record and report',
    'replay': 'recompute torque and deflection along a recorded run, and compare them with the '
    'measurement',
    'view': 'show a robot or a run in the browser: deformed links, forces, natural modes; write '
    'films',
    'identify': 'identify damping and friction from recorded motion',
    'report': 'write the HTML report of a run or of any bag',
    'calibrate': "fit a sensor's gain and offset to readings at known references",
    'recover': 'rebuild a recording that was cut off',
    'dh': 'make a URDF with flexible links from a Denavit-Hartenberg table',
    'export': "write a robot as MuJoCo's or Gazebo's model, beams as chains of sprung rods",
    'reduce': "reduce a link from its mesh, or another program's matrices, to a few modes",
    'warmup': 'compile all kernels now, once per version and user',
}


class ActionRow(NamedTuple):
    """Where an action of `denoc identify` is."""

    help: str
    # in denoc_ros: with an `Action` in `DECLARED`; or in `identification`, with the computation
    # `identify_NAME`, whose arguments are the action's options
    module: str
    pages: str = ''  # in reports: `NAME_page` and `NAME_text` of a computation, if it has its own


RECORDS, MODEL, RESULTS = 'cli.identify_records', 'cli.identify_model', 'cli.identify_results'
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
        'identification.joint',
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

# Commands that a checkout has as campaigns; they are not listed.
CAMPAIGNS = {'bench': 'bench', 'stability': 'stability', 'identify selftest': 'selftest'}
DEFAULT_ACTION = 'modal'

BAD_INPUT = 1
DOUBTFUL = 2
NOT_IDENTIFIABLE = 3
INTERRUPTED = 130  # 128 + SIGINT, as shells report it

VERDICTS = {'good': 0, 'doubtful': DOUBTFUL, 'not identifiable': NOT_IDENTIFIABLE}


def exit_status(verdict: str) -> int:
    """Return the exit status of a verdict: good, doubtful or not identifiable."""
    return VERDICTS[verdict]
