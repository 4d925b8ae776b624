"""How long other processes hold up a node that publishes: with shared memory, and with sockets.

`python -m campaigns neighbours --minutes 2`: two senders at 500 Hz beside each other, one
with each transport of Fast DDS. Listeners join all the time; of each pair one is killed and one
is first stopped for 1.5 s. Reported are the longest calls of `publish`.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence

import rclpy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from denoc_ros.cli.session.processes import free_domain
from denoc_ros.nodes.base.middleware import use_sockets

PERIOD = 0.002  # s
STAYS, STOPPED = 4.0, 1.5  # s
LONG = 0.3  # s; the machine's own load makes less
TRANSPORTS = ('shared memory', 'sockets')


def send(transport: str, seconds: float) -> None:
    """Publish for some time; print the longest calls [s] as JSON."""
    if transport == 'sockets':
        use_sockets()
    rclpy.init()
    node = rclpy.create_node('sender')
    publisher = node.create_publisher(JointState, 'torque', 1)
    message = serialize_message(JointState(name=['joint'] * 14, effort=[1.0] * 14))
    calls = []
    end = time.perf_counter() + seconds
    while (began := time.perf_counter()) < end:
        publisher.publish(message)
        calls.append(time.perf_counter() - began)
        time.sleep(PERIOD)
    print(json.dumps(sorted(calls, reverse=True)[:12]), flush=True)


def listen() -> None:
    """Join, and listen until killed."""
    rclpy.init()
    node = rclpy.create_node('listener')
    node.create_subscription(JointState, 'torque', lambda message: None, 1)
    rclpy.spin(node)


def join_and_go(end: float) -> int:
    """Start pairs of listeners and kill them, one of each after a stop; return how many."""
    count = 0
    while time.perf_counter() < end:
        pair = [_process('listen') for _ in range(2)]
        time.sleep(STAYS)
        pair[0].send_signal(signal.SIGSTOP)
        pair[1].kill()
        time.sleep(STOPPED)
        pair[0].send_signal(signal.SIGCONT)
        pair[0].kill()
        for process in pair:
            process.wait()
        count += len(pair)
    return count


def _process(*arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, '-m', 'bench.loops.neighbours', *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


def compare(minutes: float) -> None:
    """Run both senders beside each other and print what held them up."""
    seconds = 60.0 * minutes
    os.environ['ROS_DOMAIN_ID'] = str(free_domain())
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    senders = {name: _process('send', name, str(seconds)) for name in TRANSPORTS}
    found: dict[str, list[float]] = {}

    def collect(name: str) -> None:
        found[name] = json.loads(senders[name].communicate()[0])

    readers = [threading.Thread(target=collect, args=(name,)) for name in TRANSPORTS]
    for reader in readers:
        reader.start()
    joined = join_and_go(time.perf_counter() + seconds - STAYS)
    for reader in readers:
        reader.join()
    print(f'{joined} listeners joined in {seconds:.0f} s')
    for name, calls in found.items():
        over = sum(call > LONG for call in calls)
        longest = ', '.join(f'{1e3 * call:.0f}' for call in calls[:5])
        print(f'{name}: {over} calls over {1e3 * LONG:.0f} ms; the longest {longest} ms')


def main(argv: Sequence[str] | None = None) -> int:
    """Compare, or be one of the processes compared."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument(
        'role', nargs='?', choices=['compare', 'send', 'listen'], default='compare'
    )
    parser.add_argument('transport', nargs='?', choices=TRANSPORTS, default='sockets')
    parser.add_argument('seconds', nargs='?', type=float, default=10.0)
    parser.add_argument('--minutes', type=float, default=2.0)
    args = parser.parse_args(argv)
    if args.role == 'send':
        send(args.transport, args.seconds)
    elif args.role == 'listen':
        listen()
    else:
        compare(args.minutes)
    return 0


if __name__ == '__main__':
    sys.exit(main())
