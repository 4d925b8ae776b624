"""Verbs of `denoc` and actions of `denoc identify`, with a line of help each; exit statuses."""

from __future__ import annotations

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
    'stability': "compare the recursion's numerical stability with dense Cholesky's",
    'warmup': 'compile all kernels now, once per version and user',
    'bench': 'check results, then time the dynamics beside Pinocchio and dense Cholesky',
}

ACTIONS = {
    'info': 'rate, gaps, jitter, clipping, noise of the signals of a recording',
    'segment': 'find releases, free decays, steps and rests in a signal',
    'modal': 'modes and damping ratios of a free decay, or of a folder of them',
    'joint': 'viscous and Coulomb friction of a joint from a free swing',
    'forced': 'modes from torque and response',
    'servo': 'bandwidth, damping, delay and static gain of position-controlled joints',
    'model': 'stiffness, payload, inertia, friction, gains and delays of a whole robot',
    'excite': 'plan the motion whose recording identifies numbers of a robot best',
    'apply': "write identified damping into a robot's URDF",
    'compare': 'modes of several runs: mean, spread, repeatability',
    'postures': 'modes at several postures as a table for the shaper',
    'selftest': 'accuracy of the estimators on synthetic decays with known truth',
}

# verbs of the room of studies, which no other room imports
STUDIES = ('dh', 'stability', 'bench')

# module of an action, in denoc_ros
ACTION_MODULES = {
    **dict.fromkeys(
        ('info', 'segment', 'modal', 'joint', 'forced', 'servo'), 'cli.identify_records'
    ),
    **dict.fromkeys(('model', 'excite'), 'cli.identify_model'),
    **dict.fromkeys(('apply', 'compare', 'postures'), 'cli.identify_results'),
    'selftest': 'studies.selftest',
}
DEFAULT_ACTION = 'modal'

BAD_INPUT = 1
DOUBTFUL = 2
NOT_IDENTIFIABLE = 3
INTERRUPTED = 130  # 128 + SIGINT, as shells report it

VERDICTS = {'good': 0, 'doubtful': DOUBTFUL, 'not identifiable': NOT_IDENTIFIABLE}


def exit_status(verdict: str) -> int:
    """Return the exit status of a verdict: good, doubtful or not identifiable."""
    return VERDICTS[verdict]
