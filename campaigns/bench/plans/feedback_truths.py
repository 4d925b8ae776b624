"""Tip errors of the Canadarm's tip-exact motion on robots with modes that its model leaves out.

`python -m campaigns feedback --seeds 4` prints a table: root mean
square while moving and largest error from 3 s after, of the plan's torque alone, with the joints'
own feedback, and with state feedback.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from feedback_runs import Loop, canadarm, described, tip_exact

from denoc_ros.feedback.state_feedback import StateFeedback

BEAMS = {
    'craig-bampton 2': described(),
    'craig-bampton 4': described(modes=4),
    'clamped-free 4': described('clamped-free', modes=4),
    'clamped-free 8': described('clamped-free', modes=8),
    '8 segments': described(segments=8),
    'MuJoCo': described(),
}
HINGES = 16  # per beam in MuJoCo
OFF = ((1.0, 1.0), (0.9, 1.2), (0.8, 0.8), (0.8, 1.2), (1.2, 0.8), (1.2, 1.2))  # stiffness, load
WAYS = ('plan alone', 'joints', 'state feedback')


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seeds', type=int, default=1, help='of noise; the worst counts')
    parser.add_argument('--rate', type=float, default=1000.0, help='of the loop [Hz]')
    parser.add_argument('--delay', type=float, default=1.5, help='of the torque [periods]')
    parser.add_argument('--waits', type=float, default=0.0, help='at rest before the motion [s]')
    parser.add_argument('--beams', nargs='+', choices=BEAMS, default=list(BEAMS))
    args = parser.parse_args(arguments)
    planned = tip_exact(source=described(), period=1.0 / args.rate)
    schedule = planned.schedule()
    print(f'| true beams | EI, load | {" | ".join(WAYS)} |  [mm]')
    for name in args.beams:
        for stiffness, load in OFF:
            truth, cells = canadarm(stiffness, load, BEAMS[name]), []
            for way in WAYS:
                runs = []
                for seed in range(1, 2 if way == WAYS[0] else args.seeds + 1):
                    feedback = StateFeedback(planned.robot, schedule)
                    used = None if way == WAYS[0] else feedback
                    loop = Loop(
                        planned, truth, used, seed, joints_alone=way == WAYS[1],
                        hinges=HINGES if name == 'MuJoCo' else 0, delay=args.delay,
                        waits=args.waits,
                    )  # fmt: skip
                    runs.append(loop.run())
                moving = max(run.rms for run in runs)
                after = max(run.after(3.0) for run in runs)
                cells.append(f'{1e3 * moving:.3g} / {1e3 * after:.3g}')
            print(f'| {name} | {stiffness:g}, {load:g} | {" | ".join(cells)} |', flush=True)


if __name__ == '__main__':
    main()
