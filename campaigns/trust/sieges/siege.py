"""The siege: whatever can be sent to the nodes, drawn at random, and the laws that hold.

`python -m campaigns siege --minutes 60`. A round is a fresh stage with one of the robots of
`trust.sieges.siege_scenes`; the seed of each is printed, and gives the same steps again. Of what
broke a law, the steps are written to a file and shrunk to the few that still break it.
"""

from __future__ import annotations

import argparse
import json
import secrets
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from itertools import chain, count
from pathlib import Path
from typing import Any

import numpy as np
from trust.assault import Assault
from trust.attacks import Inventory, Step, discover, draw_step
from trust.laws import Life
from trust.mending import Mending
from trust.sieges.shrinking import shrink
from trust.sieges.siege_scenes import SCENES, Scene
from trust.sieges.siege_stage import PATIENCE, SiegeStage, besieged

ROUND = 900.0  # s
FAILED = Path('runs', 'siege-failed.json')
BETWEEN_RESTS = 6  # steps
MORTAL = 2  # nodes that may be told to end in a round: the others grow old, for their memory
KINDS = ('messages', 'requests', 'transitions', 'signals', 'joins', 'files')


@dataclass
class Failure:
    """A broken law, and the step at which it was seen."""

    law: str
    step: int


@dataclass
class Round:
    """What one round did and what came of it."""

    scene: str
    seed: int
    seconds: float = 0.0
    steps: list[Step] = field(default_factory=list)
    failures: list[Failure] = field(default_factory=list)
    sent: dict[str, dict[str, int]] = field(default_factory=dict)  # by node, by kind
    torques: int = 0
    fed: int = 0
    largest_delta: float = 0.0
    longest_answer: float = 0.0  # s
    longest_mending: float = 0.0  # s until all was as before a step, new starts among it
    pauses: dict[str, float] = field(default_factory=dict)
    estimates: dict[str, Any] = field(default_factory=dict)  # of the payload
    lives: list[dict[str, Any]] = field(default_factory=list)


def drawn(seed: int, inventory: Inventory) -> Iterator[Step]:
    """Yield steps without end, the same for the same seed and what the nodes offer."""
    rng = np.random.default_rng(seed)
    mortal = tuple(sorted(rng.choice(inventory.nodes, MORTAL, replace=False).tolist()))
    while True:
        yield draw_step(rng, inventory, mortal)


def with_rests(steps: Iterable[Step]) -> Iterator[Step]:
    """Yield steps, and after each few a rest in which nothing is attacked."""
    for number, step in enumerate(steps):
        yield step
        if number % BETWEEN_RESTS == BETWEEN_RESTS - 1:
            yield [{'do': 'rest', 'node': 'predictor'}]


class Siege:
    """One round: steps done to a stage, and the laws held."""

    def __init__(self, stage: SiegeStage, told: Round) -> None:
        self.stage, self.round = stage, told
        self.mending: Mending

    def begin(self) -> Inventory:
        """Wait until all nodes do what they are for; return what they offer."""
        stage = self.stage
        assault = Assault(stage, Inventory({}, {}, {node: {} for node in stage.scene.nodes}, []))
        self.mending = Mending(stage, assault)
        end = time.perf_counter() + PATIENCE
        broken: list[str] = []
        self.mending.mend([], broken.append)
        while broken and time.perf_counter() < end:  # kernels that compile take longer than a mend
            broken.clear()
            self.mending.mend([], broken.append)
        if broken:
            raise AssertionError(f'the stage must come up, got {broken}')
        inventory = discover(stage)
        assault.inventory = self.mending.inventory = inventory
        stage.judge(final=True)
        stage.witness.pauses.clear()
        return inventory

    def run(self, steps: Iterable[Step], seconds: float, stop: bool, verbose: bool) -> None:
        """Do steps for a time; with `stop` only until a law is broken."""
        begin = time.monotonic()
        for step in steps:
            if time.monotonic() - begin > seconds:
                break
            self.round.steps.append(step)
            if verbose:
                print(f'{time.monotonic() - begin:.1f} s: {json.dumps(step)}', flush=True)
            self.mending.assault.do(step)
            done = time.monotonic()
            self.mending.mend(step, self._hold)
            took = time.monotonic() - done
            self.round.longest_mending = max(self.round.longest_mending, took)
            for law in self.stage.judge():
                self._hold(law)
            if stop and self.round.failures:
                break
        time.sleep(1.0)  # what is under way
        for law in self.stage.judge(final=True):
            self._hold(law)
        self.round.seconds = time.monotonic() - begin
        self._count()

    def _hold(self, law: str) -> None:
        """Keep and print a broken law, seen at the newest step."""
        number = len(self.round.steps) - 1
        self.round.failures.append(Failure(law, number))
        print(f'BROKEN at step {number}: {law}', flush=True)
        print(f'  {json.dumps(self.round.steps[number])}', flush=True)

    def _count(self) -> None:
        told, stage = self.round, self.stage
        for (node, kind), number in self.mending.assault.tally.items():
            told.sent.setdefault(node, {})[kind] = number
        witness = stage.witness
        told.torques, told.fed = witness.efforts.count, stage.fed
        told.largest_delta = max(witness.efforts.largest_delta, witness.commands.largest_delta)
        told.longest_answer = stage.longest_answer
        told.pauses = witness.pauses_told()
        told.estimates = stage.estimates.summary()
        for life in witness.lives.values():
            told.lives.append(of_life(life))
            if life.name in stage.scene.nodes:
                for law in life.judge():
                    self._hold(law)


def of_life(life: Life) -> dict[str, Any]:
    """Return memory [MB] and descriptors of a process: first, last, slope."""
    from trust.laws import slope

    at, memory, files = life.settled()
    if len(at) < 2:
        return {'name': life.name, 'pid': life.pid, 'seconds': len(life.at)}
    return {
        'name': life.name,
        'pid': life.pid,
        'seconds': round(life.at[-1] - life.at[0]),
        'memory_first_mb': 1e-6 * float(memory[0]),
        'memory_last_mb': 1e-6 * float(memory[-1]),
        'memory_mb_per_hour': 3.6e-3 * slope(at, memory),
        'descriptors_first': int(files[0]),
        'descriptors_last': int(files[-1]),
        'descriptors_per_hour': 3600.0 * slope(at, files),
    }


def one_round(
    scene: Scene,
    seed: int,
    seconds: float,
    folder: Path,
    steps: Iterable[Step] | None = None,
    stop: bool = False,
    slack: float = 0.0,
    verbose: bool = False,
) -> Round:
    """Besiege a fresh stage for a time [s], with steps that are given or drawn by the seed."""
    told = Round(scene.name, seed)
    print(f'scene {scene.name}, seed {seed}', flush=True)
    with besieged(folder, scene, slack) as stage:
        siege = Siege(stage, told)
        inventory = siege.begin()
        if steps is None:
            first = ([{**attack, 'seed': seed}] for attack in scene.first)
            steps = chain(first, drawn(seed, inventory))
            steps = with_rests(steps) if scene.adapts else steps
        siege.run(steps, seconds, stop, verbose)
    return told


def rounds(
    seed: int,
    seconds: float,
    folder: Path,
    scenes: Sequence[Scene],
    slack: float,
    verbose: bool,
) -> Iterator[Round]:
    """Yield rounds until the time [s] is over, each scene in its turn."""
    end = time.monotonic() + seconds
    length = min(ROUND, seconds / len(scenes)) if seconds > 600.0 else seconds
    for number in count():
        left = end - time.monotonic()
        if left < 5.0:
            return
        scene = scenes[(seed + number) % len(scenes)]
        place, last = folder / str(number), min(length, left)
        yield one_round(scene, seed + number, last, place, slack=slack, verbose=verbose)


def shrunk(told: Round, folder: Path, seconds: float) -> list[Step] | None:
    """Return few steps that break a law as the round's first failure did, None if none does."""
    numbers = count()

    def fails(steps: list[Step]) -> bool:
        place = folder / f'try-{next(numbers)}'
        tried = one_round(SCENES[told.scene], told.seed, 600.0, place, steps, stop=True)
        return any(kind_of(failure.law) == wanted for failure in tried.failures)

    first = told.failures[0]
    wanted = kind_of(first.law)
    return shrink(told.steps[: first.step + 1], fails, seconds)


def kind_of(law: str) -> str:
    """Return a law without its numbers."""
    return law.split(', got')[0].split('\n')[0]


def write_steps(path: Path, told: Round, steps: Sequence[Step]) -> None:
    """Write a sequence that `--replay` reads."""
    lines = ',\n'.join(json.dumps(step) for step in steps)
    head = f'"scene": "{told.scene}", "seed": {told.seed}'
    path.write_text(f'{{{head}, "steps": [\n{lines}\n]}}\n')


def table(told: Sequence[Round]) -> str:
    """Return what was sent, by node, and what came of it."""
    sent: Counter[tuple[str, str]] = Counter()
    for each in told:
        for node, kinds in each.sent.items():
            for kind, number in kinds.items():
                sent[node, kind] += number
    lines = ['node | ' + ' | '.join(KINDS), '---|' * len(KINDS) + '---']
    for node in dict.fromkeys(node for each in told for node in SCENES[each.scene].nodes):
        lines.append(f'{node} | ' + ' | '.join(str(sent[node, kind]) for kind in KINDS))
    laws = Counter(kind_of(failure.law) for each in told for failure in each.failures)
    lines.append(
        f'{sum(each.seconds for each in told):.0f} s, {sum(len(each.steps) for each in told)} '
        f'steps, {sum(each.torques for each in told)} torque messages; '
        f'laws broken: {laws.total()}'
    )
    lines += [f'  {number} times: {law}' for law, number in laws.most_common()]
    lines += [f'  {json.dumps(life)}' for each in told for life in each.lives]
    for each in told:
        lines.append(
            f'  {each.scene}, {each.seconds:.0f} s: pauses {json.dumps(each.pauses)}; largest '
            f'change {each.largest_delta:g}; longest answer {each.longest_answer:.2f} s, longest '
            f'mending {each.longest_mending:.1f} s'
        )
        if each.estimates.get('messages'):
            lines.append(f'  payload [kg]: {json.dumps(each.estimates)}')
    return '\n'.join(lines)


def replay(path: Path, folder: Path, verbose: bool) -> Round:
    """Do a written sequence again."""
    given = json.loads(path.read_text())
    scene = SCENES[given['scene']]
    return one_round(scene, given['seed'], 3600.0, folder, given['steps'], verbose=verbose)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--minutes', type=float, default=60.0)
    parser.add_argument('--seed', type=int, help='of the first round; drawn where none is given')
    parser.add_argument(
        '--scene', choices=SCENES, action='append', help='one or more; default all'
    )
    parser.add_argument('--replay', type=Path, metavar='FILE', help='steps to do again, once')
    parser.add_argument('--json', type=Path, help='file for all that was done and seen')
    parser.add_argument('--failed', type=Path, default=FAILED, metavar='FILE')
    parser.add_argument('--shrink', type=float, default=600.0, metavar='SECONDS')
    parser.add_argument(
        '--slack',
        type=float,
        default=0.0,
        metavar='SECONDS',
        help='that torque may pause beyond the law, on a machine that does other things',
    )
    parser.add_argument('--verbose', action='store_true', help='print each step')
    args = parser.parse_args(argv)
    seed = secrets.randbelow(1 << 30) if args.seed is None else args.seed
    scenes = [SCENES[name] for name in args.scene or SCENES]
    # what is ignored here, as nohup asks for, would be ignored by the nodes
    signal.signal(signal.SIGHUP, lambda *_: None)
    told: list[Round] = []
    for path in (args.json, args.failed):
        if path:
            path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix='siege-') as place:
        folder = Path(place)
        if args.replay:
            told.append(replay(args.replay, folder / 'replay', args.verbose))
        else:
            seconds = 60.0 * args.minutes
            for each in rounds(seed, seconds, folder, scenes, args.slack, args.verbose):
                told.append(each)
                if args.json:
                    args.json.write_text(json.dumps([asdict(r) for r in told]))
        print(table(told), flush=True)
        failed = next((each for each in told if each.failures), None)
        if failed is not None:
            steps = failed.steps[: failed.failures[0].step + 1]
            write_steps(args.failed, failed, steps)
            found = (
                shrunk(failed, folder, args.shrink) if args.shrink and not args.replay else None
            )
            if found is not None:
                write_steps(args.failed, failed, found)
                print(f'shrunk to {len(found)} steps: {json.dumps(found)}')
            print(f'once more: --replay {args.failed}')
    if args.json:
        args.json.write_text(json.dumps([asdict(each) for each in told]))
    return 2 if failed is not None else 0


if __name__ == '__main__':
    sys.exit(main())
