"""The campaigns: name, module, what each measures, how long it takes; and how one is run."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
SUPPORT = 'robots', 'oracles', 'runs', 'node_benches', 'files'
# where campaigns import from, below the root
FOLDERS = ('campaigns', 'test', *(f'test/support/{name}' for name in SUPPORT))
SETTINGS = {
    'OPENBLAS_NUM_THREADS': '1',  # Threads of BLAS would wait for each other.
    'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
    'ROS_LOG_DIR': str(ROOT / 'log' / 'ros'),
}


class Campaign(NamedTuple):
    """One row of the table."""

    command: str  # module, and the arguments that it always gets
    measures: str
    duration: str
    options: str = ''  # used if none are given
    settings: tuple[tuple[str, str], ...] = ()  # of the environment


CAMPAIGNS = {
    'bench': Campaign(
        'book bench', 'results and time of the dynamics beside Pinocchio', 'minutes'
    ),
    'stability': Campaign(
        'book stability', "the recursion's numerical stability beside Cholesky's", 'minutes'
    ),
    'selftest': Campaign(
        'book selftest', 'accuracy of the estimators on synthetic decays', 'minutes'
    ),
    'rates': Campaign(
        'bench.loops.rates', 'missed deadlines, lost messages and load of the nodes', '7 min'
    ),
    'tick': Campaign('bench.ticks.tick_latency', 'time of a tick beside an empty node', 'minutes'),
    'bytecodes': Campaign(
        'bench.ticks.tick_bytecodes', 'bytecodes and Python calls of a tick', 'minutes'
    ),
    'recorder': Campaign(
        'bench.loops.recorder_load', '50 topics with 5 MB/s, all recorded', '2 min'
    ),
    'lateness': Campaign(
        'bench.loops.loop_lateness', 'delay of a loop by the recorder and by bad input', '3 min'
    ),
    'watched': Campaign(
        'bench.loops.viewer_lateness', 'delay of the loops by the viewer', '3 min'
    ),
    'requests': Campaign('bench.loops.request_lateness', 'delay of a loop by requests', '20 min'),
    'neighbours': Campaign(
        'bench.loops.neighbours', 'delay of a publisher by killed listeners', 'minutes'
    ),
    'long-bag': Campaign('bench.long_bag', 'time and memory of the replay of 1 GB', '10 min'),
    'meshed': Campaign('bench.links.meshed_speed', 'time of meshed links beside beams', 'minutes'),
    'five-bar': Campaign('bench.links.exudyn_five_bar', 'the five-bar beside Exudyn', 'minutes'),
    'exudyn-links': Campaign(
        'bench.links.exudyn_links', 'meshed and tapered links beside Exudyn', 'minutes'
    ),
    'circle': Campaign(
        'bench.links.platform_circle',
        'the three-legged manipulator on a circle',
        'minutes',
        'docs/platform_circle.png',
    ),
    'deflections': Campaign(
        'bench.links.small_deflections',
        'how far small deflections reach',
        'minutes',
        'docs/small_deflections.png',
    ),
    'tips': Campaign('bench.plans.mujoco_tips', 'errors of tip-exact plans in MuJoCo', '30 min'),
    'plans': Campaign(
        'bench.plans.tip_motions', 'errors and computing time of tip-exact plans', 'minutes'
    ),
    'fastest': Campaign('bench.plans.fastest', 'minimum times beside TOPP-RA', '15 min'),
    'rests': Campaign('bench.plans.rest_cycles', 'cycle times and swing of shapers', 'minutes'),
    'ipopt-path': Campaign(
        'bench.plans.path_by_ipopt', 'minimum times on a path beside IPOPT', 'minutes'
    ),
    'ipopt-rest': Campaign('bench.plans.rest_by_ipopt', 'rest to rest beside IPOPT', 'minutes'),
    'feedback': Campaign(
        'bench.plans.feedback_truths', 'tip errors with feedback on other robots', 'minutes'
    ),
    'sensors': Campaign('bench.sensors.sensor_faults', 'detection of faulty sensors', 'hours'),
    'identification': Campaign(
        'bench.identify.identify_truth',
        'errors of the identification of 100 random robots',
        '1 h',
        '--count 100 --json runs/identification.json',
    ),
    'strangers': Campaign(
        'bench.identify.identify_strangers', 'verdicts on strange records', '2 min'
    ),
    'peers': Campaign(
        'bench.identify.identify_peers',
        "identification beside others; pip install 'mujoco[sysid]' figaroh",
        'minutes',
    ),
    'folder': Campaign(
        'bench.identify.identify_folder', 'throughput of identified folders', 'minutes'
    ),
    'counts': Campaign('bench.counts', 'lines, lengths, arguments, import circles', '10 s'),
    'soak': Campaign('trust.run', 'motion and torque under all faults', '10 min'),
    'inputs': Campaign(
        'trust.inputs.input_faults', 'outputs under random faults of inputs', 'minutes'
    ),
    'siege': Campaign(
        'trust.sieges.siege',
        'laws under random messages, requests and signals',
        '1 h',
        '--minutes 60 --json runs/siege.json',
    ),
    'ends': Campaign('trust.endings.ends_campaign', '500 ends of each node by signals', '2 h'),
    'session-ends': Campaign('trust.endings.session_ends', '100 interrupted sessions', 'minutes'),
    'session-failures': Campaign(
        'trust.endings.session_failures', 'sessions whose nodes are killed', 'minutes'
    ),
    'gauges': Campaign(
        'trust.inputs.gauge_relay', 'deflection with faulty gauges over DDS', 'minutes'
    ),
    'pauses': Campaign(
        'trust.endings.paused_feedback', 'feedback while processes are stopped', 'minutes'
    ),
    'parts': Campaign('trust.removed_parts', 'the package without each optional part', '1 h'),
    'smoke': Campaign('trust.smoke', 'the wheel in an empty environment', '3 min'),
    'bounds': Campaign(
        'pytest test/kernels test/dynamics',
        'offsets of kernels: tests of the dynamics with checked bounds',
        '15 min',
        settings=(('DENOC_CHECK_BOUNDS', '1'),),
    ),
    'fuzz': Campaign(
        'pytest --hypothesis-profile fuzz test/fuzz', 'corrupted robots and recordings', '15 min'
    ),
}


def main(arguments: Sequence[str]) -> int:
    """Print the table, or replace this process by a campaign."""
    name, options = (arguments[0], list(arguments[1:])) if arguments else ('--help', [])
    if name in ('-h', '--help'):
        print('usage: python -m campaigns NAME [options], from the root of a checkout\n')
        for each, row in CAMPAIGNS.items():
            print(f'{each:<17}{row.duration:<12}{row.measures}')
        return 0
    if name in CAMPAIGNS:
        row = CAMPAIGNS[name]
        words = [*row.command.split(), *(options or row.options.split())]
        os.execve(sys.executable, [sys.executable, '-m', *words], environment(row))
    names = ', '.join(CAMPAIGNS)
    print(f'NAME must be one of {names}; got {name}', file=sys.stderr)
    return 1


def import_paths() -> list[str]:
    """Return the folders that campaigns and their processes import from."""
    return [str(ROOT / folder) for folder in FOLDERS]


def environment(row: Campaign) -> dict[str, str]:
    """Return the environment of a campaign: this process's, with paths and settings."""
    paths = import_paths()
    paths += filter(None, [os.environ.get('PYTHONPATH')])
    return {
        **SETTINGS,
        **os.environ,
        **dict(row.settings),
        'PYTHONPATH': os.pathsep.join(paths),
    }
