"""Asks a node without pause: sets its parameters, and calls its services at random.

`python -m bench.loops.requester FILE NODE RATE PARAMETER:LOW:HIGH …`: RATE sets of one of the
parameters a second, to a random number between, and as many calls of services drawn at random:
rclpy's of parameters and of the lifecycle, and Trigger. It listens to `/NODE/commands`. SIGUSR1
begins, SIGUSR2 pauses, SIGINT ends and writes FILE: how many were sent, answered, refused, and the
worst time to an answer [s].
"""

from __future__ import annotations

import json
import random
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
from lifecycle_msgs.srv import GetAvailableStates, GetAvailableTransitions, GetState
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
)
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

PATIENCE = 10.0  # s for an answer
WAITING = 6  # requests that may wait for one: DDS keeps ten, and drops the eldest


class Requester:
    """What is asked of one node.

    Parameters
    ----------
    node : Node
        The one that asks.
    name : str
        Of the one that is asked.
    ranges : dict
        Lowest and highest value by parameter.
    """

    def __init__(self, node: Node, name: str, ranges: dict[str, tuple[float, float]]) -> None:
        self.sent = self.answered = self.refused = 0
        self.worst = 0.0
        self._waiting: set[float] = set()
        self._ranges = ranges
        some = list(ranges)
        self._set = node.create_client(SetParameters, f'/{name}/set_parameters')
        asked: list[tuple[type, str, Callable[[], Any]]] = [
            (GetParameters, 'get_parameters', lambda: GetParameters.Request(names=some)),
            (ListParameters, 'list_parameters', ListParameters.Request),
            (
                DescribeParameters,
                'describe_parameters',
                lambda: DescribeParameters.Request(names=some),
            ),
            (
                GetParameterTypes,
                'get_parameter_types',
                lambda: GetParameterTypes.Request(names=some),
            ),
            (GetState, 'get_state', GetState.Request),
            (GetAvailableStates, 'get_available_states', GetAvailableStates.Request),
            (
                GetAvailableTransitions,
                'get_available_transitions',
                GetAvailableTransitions.Request,
            ),
            (GetAvailableTransitions, 'get_transition_graph', GetAvailableTransitions.Request),
            (Trigger, 'reset', Trigger.Request),
        ]
        self._services = [
            (node.create_client(kind, f'/{name}/{service}'), make) for kind, service, make in asked
        ]

    @property
    def waits(self) -> bool:
        """Whether answers may still come."""
        return any(time.perf_counter() - begin < PATIENCE for begin in self._waiting)

    def ask(self) -> None:
        """Set one parameter and call one service that the node has."""
        name = random.choice(list(self._ranges))
        value = Parameter(name, value=random.uniform(*self._ranges[name])).to_parameter_msg()
        self._call(self._set, SetParameters.Request(parameters=[value]))
        ready = [each for each in self._services if each[0].service_is_ready()]
        if ready:
            client, make = random.choice(ready)
            self._call(client, make())

    def _call(self, client: Any, request: Any) -> None:
        if len(self._waiting) >= WAITING and self.waits:
            return  # it is behind
        if not client.service_is_ready():
            return
        begin = time.perf_counter()
        self._waiting.add(begin)
        self.sent += 1

        def on_answer(future: Any) -> None:
            self._waiting.discard(begin)
            self.answered += 1
            self.worst = max(self.worst, time.perf_counter() - begin)
            for result in getattr(future.result(), 'results', ()):
                self.refused += not result.successful

        client.call_async(request).add_done_callback(on_answer)


def main() -> None:
    file, name, rate = Path(sys.argv[1]), sys.argv[2], float(sys.argv[3])
    rows = [row.rsplit(':', 2) for row in sys.argv[4:]]
    ranges = {parameter: (float(low), float(high)) for parameter, low, high in rows}
    told = [False, False]  # asks, ends
    signal.signal(signal.SIGUSR1, lambda *_: told.__setitem__(0, True))
    signal.signal(signal.SIGUSR2, lambda *_: told.__setitem__(0, False))
    signal.signal(signal.SIGINT, lambda *_: told.__setitem__(1, True))
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = Node(f'requester_of_{name}', use_global_arguments=False)
    node.create_subscription(Float64MultiArray, f'/{name}/commands', lambda _: None, 1, raw=True)
    requester = Requester(node, name, ranges)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    due = time.perf_counter()
    while not told[1]:
        now = time.perf_counter()
        if not told[0]:
            due = now
        elif now >= due:
            requester.ask()
            due = max(due + 1.0 / rate, now - 1.0)
        executor.spin_once(min(max(0.0, due - now), 0.02) or 0.001)
    end = time.perf_counter() + PATIENCE
    while requester.waits and time.perf_counter() < end:
        executor.spin_once(0.02)
    counts = {key: getattr(requester, key) for key in ('sent', 'answered', 'refused', 'worst')}
    file.write_text(json.dumps(counts))
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == '__main__':
    main()
