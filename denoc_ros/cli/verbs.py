"""Verbs of `denoc`, with a line of help each; exit statuses."""

from __future__ import annotations

from denoc_ros.parts import Verb, parts

CORE_VERBS = {
    'check': Verb(
        'validate a robot; list its links, joints, beams, frequencies and masses',
        'cli.check_verb',
    ),
    'simulate': Verb(
        'simulate a robot through a scenario, without a ROS graph', 'cli.simulate_verb'
    ),
    'up': Verb('start the nodes, run a reference, record and report', 'cli.up_verb'),
    'replay': Verb(
        'recompute torque and deflection along a recorded run, and compare them with the '
        'measurement',
        'cli.replay_verb',
    ),
    'recover': Verb('rebuild a recording that was cut off', 'cli.recover_verb'),
    'warmup': Verb('compile all kernels now, once per version and user', 'cli.warmup_verb'),
}
# Commands that a checkout has as campaigns; they are not listed.
CAMPAIGNS = {'bench': 'bench', 'stability': 'stability', 'identify selftest': 'selftest'}


def verbs() -> dict[str, Verb]:
    """Return all verbs: of the core, then of the parts that are there."""
    found = dict(CORE_VERBS)
    for part in parts().values():
        found.update(part.verbs)
    return found


BAD_INPUT = 1
DOUBTFUL = 2
NOT_IDENTIFIABLE = 3
INTERRUPTED = 130  # 128 + SIGINT, as shells report it

VERDICTS = {'good': 0, 'doubtful': DOUBTFUL, 'not identifiable': NOT_IDENTIFIABLE}


def exit_status(verdict: str) -> int:
    """Return the exit status of a verdict: good, doubtful or not identifiable."""
    return VERDICTS[verdict]
