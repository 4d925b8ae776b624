"""Nodes as processes in lockstep with a plant, driven from pause to pause."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from denoc_ros.bags.reader import read_raw
from denoc_ros.cli.session.processes import Processes
from denoc_ros.nodes.session_client import SessionClient, reference_message
from denoc_ros.parts import node_main
from denoc_ros.trajectories import Trajectory

PATIENCE = 120.0  # s of wall time for what takes a second on a machine that does nothing else
OF_THE_MACHINE = ('diagnostics', 'rosout', 'parameter_events', 'transition_event')


class LockstepStage:
    """A plant in lockstep, feedforward, predictor and recorder.

    Parameters
    ----------
    folder : Path
        New; it gets parameter files, logs and the bag.
    urdf : str
        File of the robot.
    rates : dict of str to float
        Hz of the nodes but the recorder.
    more : dict of str to dict
        Further parameters by node.
    remapped : dict of str to dict
        Other names of topics by node.
    """

    def __init__(
        self,
        folder: Path,
        urdf: str,
        rates: dict[str, float],
        more: dict[str, dict[str, Any]] | None = None,
        remapped: dict[str, dict[str, str]] | None = None,
    ) -> None:
        folder.mkdir()
        self.bag = folder / 'bag'
        self.names = [*rates, 'recorder']
        partners = [name for name in self.names if name != 'plant']
        own: dict[str, dict[str, Any]] = {name: {'update_rate': rates[name]} for name in rates}
        own['recorder'] = {'output': str(self.bag)}
        own['plant'].update(
            {
                'clock': 'lockstep',
                'lockstep.partners': partners,
                'real_time_factor': 0.0,
                'pause_at': 0.0,
            }
        )
        self.processes = Processes(folder, {})
        for name in self.names:
            given = {**own[name], **(more or {}).get(name, {})}
            if name != 'plant':
                given['use_sim_time'] = True
            if name != 'recorder':
                given.setdefault('urdf_path', urdf)
            file = folder / f'{name}.yaml'
            file.write_text(json.dumps({name: {'ros__parameters': given}}))
            words = ['-m', node_main(name), '--ros-args', '--params-file', str(file)]
            for topic, other in (remapped or {}).get(name, {}).items():
                words += ['-r', f'{topic}:={other}']
            self.processes.start(name, words)
        self.client = SessionClient(
            Path(urdf).read_text(encoding='utf-8'), watch=self.processes.check
        )
        for name in self.names:
            self.processes.check()
            self.client.wait_active(name, PATIENCE)
        self._require_topics()

    def __enter__(self) -> LockstepStage:
        return self

    def __exit__(self, *_error: object) -> None:
        self.client.close()
        self.processes.stop_all(['recorder'])

    def _require_topics(self) -> None:
        """Wait until the recorder has found all topics."""
        before, since = '', time.perf_counter()
        while time.perf_counter() - since < 2.5:
            self.client.wait(0.1)
            found = self.client.diagnostics('recorder: recording').get('topics', '')
            if found != before:
                before, since = found, time.perf_counter()

    def go_to(self, moment: float) -> float:
        """Let time go on to a moment [s] and stand there; return the wall time that took [s]."""
        begin = time.perf_counter()
        self.client.set_parameters('plant', {'pause_at': moment})

        def there() -> bool:
            self.processes.check()
            said = self.client.diagnostics('plant: clock')
            return said.get('paused') == 'True' and abs(float(said['time_s']) - moment) < 1e-6

        assert self.client.until(there, PATIENCE), self.client.diagnostics('plant: clock')
        return time.perf_counter() - begin

    def follow(self, joints: Sequence[str], trajectory: Trajectory, start: float) -> None:
        """Publish a reference that starts at a moment [s], and wait until all have it."""
        listeners = [name for name in ('feedforward', 'predictor') if name in self.names]
        before = sum(map(self._accepted, listeners))
        publisher: Any = self.client._reference
        assert self.client.until(
            lambda: publisher.get_subscription_count() >= len(listeners), PATIENCE
        )
        publisher.publish(reference_message(trajectory, list(joints), round(1e9 * start)))
        heard = before + len(listeners)
        assert self.client.until(lambda: sum(map(self._accepted, listeners)) >= heard, PATIENCE)

    def _accepted(self, name: str) -> int:
        return int(self.client.diagnostics(f'{name}: inputs').get('reference accepted', 0))

    def signal(self, name: str, number: signal.Signals) -> None:
        """Send a process a signal."""
        os.kill(self.processes._running[name].pid, number)

    def finish(self) -> dict[str, list[tuple[int, bytes]]]:
        """End the recording; return log times [ns] and bytes by topic."""
        self.client.trigger('/recorder/stop')
        return messages(self.bag)


def messages(bag: Path) -> dict[str, list[tuple[int, bytes]]]:
    """Return log times [ns] and bytes of a bag by topic, but for what tells of the machine."""
    found: dict[str, list[tuple[int, bytes]]] = {}
    for topic, _, log_ns, raw in read_raw(bag):
        if topic.rpartition('/')[2] not in OF_THE_MACHINE:
            found.setdefault(topic, []).append((log_ns, bytes(raw)))
    return found


def differences(
    one: dict[str, list[tuple[int, bytes]]], other: dict[str, list[tuple[int, bytes]]]
) -> dict[str, str]:
    """Return in what topics of two bags differ; empty where they do not."""
    found = {}
    for topic in sorted(one.keys() | other.keys()):
        a, b = one.get(topic, []), other.get(topic, [])
        payload = [k for k, (x, y) in enumerate(zip(a, b, strict=False)) if x[1] != y[1]]
        times = [k for k, (x, y) in enumerate(zip(a, b, strict=False)) if x[0] != y[0]]
        if len(a) != len(b) or payload or times:
            found[topic] = (
                f'{len(a)} and {len(b)} messages, {len(payload)} differ in payload '
                f'(first {payload[:1]}), {len(times)} in log time (first {times[:1]})'
            )
    return found
