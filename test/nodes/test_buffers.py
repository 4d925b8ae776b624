"""What messages take of a node's memory is given back once they are read."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from child_processes import child
from rclpy.duration import Duration
from std_msgs.msg import String

from denoc_ros.nodes.base.middleware import (
    BUFFERS,
    FROM_PROFILES,
    LOCALHOST,
    PROFILES,
    RANGE,
    TRANSPORTS,
    release_buffers,
    use_sockets,
)
from denoc_ros.runtime.loop.realtime import CHOSEN, return_large_pieces

FASTRTPS = 'rmw_fastrtps_cpp'
MESSAGES, SIZE = 200, 50_000  # bytes each: one datagram, so that none waits for its fragments
HEAP = """
import ctypes, sys, rclpy
from denoc_ros.errors import DenocError
from denoc_ros.nodes.base.messages import EVERY_MESSAGE
from denoc_ros.nodes.base.process import run
from std_msgs.msg import String

FIELDS = 'arena ordblks smblks hblks hblkhd usmblks fsmblks uordblks fordblks keepcost'
class Heap(ctypes.Structure):
    _fields_ = [(name, ctypes.c_size_t) for name in FIELDS.split()]
libc = ctypes.CDLL(None)
libc.mallinfo2.restype = Heap
"""
# reads, when told to, what waits, and prints how many and the heap in use
LISTENER = f"""{HEAP}

def listen():
    node = rclpy.create_node('listener')
    subscription = node.create_subscription(String, 'large', print, EVERY_MESSAGE, raw=True)
    for _ in sys.stdin:
        count = 0
        while subscription.handle.take_message(String, True):
            count += 1
        heap = libc.mallinfo2()
        print(count, heap.uordblks + heap.hblkhd, flush=True)
    node.destroy_node()
    raise DenocError('over')

sys.exit(run(listen, [], shared_memory=sys.argv[1] == 'shared'))
"""
# prints what the heap keeps of a large piece that was freed below one that stays
KEEPER = f"""{HEAP}
libc.malloc.restype = ctypes.c_void_p
libc.malloc.argtypes = [ctypes.c_size_t]
libc.free.argtypes = [ctypes.c_void_p]

def keep():
    libc.free(libc.malloc(8_000_000))  # from now on glibc would take less than that from the heap
    before = libc.mallinfo2().fordblks
    piece = libc.malloc(4_000_000)
    libc.malloc(100_000)
    libc.free(piece)
    print(libc.mallinfo2().fordblks - before, flush=True)
    raise DenocError('over')

sys.exit(run(keep, [], shared_memory=True))
"""

# publishes, and prints whether all of it has arrived within a second, several times
PUBLISHER = """
import sys, time, rclpy
from denoc_ros.errors import DenocError
from denoc_ros.nodes.base.messages import STATE
from denoc_ros.nodes.base.process import run
from rclpy.duration import Duration
from std_msgs.msg import String

def publish():
    node = rclpy.create_node('publisher')
    publisher = node.create_publisher(String, 'small', STATE)
    while not publisher.get_subscription_count():
        time.sleep(0.01)
    for _ in range(5):
        for _ in range(20):
            publisher.publish(String(data='x'))
        print(publisher.wait_for_all_acked(Duration(seconds=1)), flush=True)
    node.destroy_node()
    raise DenocError('over')

sys.exit(run(publish, [], shared_memory=sys.argv[1] == 'shared'))
"""


@pytest.mark.parametrize(
    ('given', 'changed'),
    [
        ({}, {TRANSPORTS: 'UDPv4', PROFILES: str(BUFFERS), FROM_PROFILES: '1'}),
        ({TRANSPORTS: 'DEFAULT'}, {PROFILES: str(BUFFERS), FROM_PROFILES: '1'}),
        (
            {RANGE: 'LOCALHOST'},
            {PROFILES: str(LOCALHOST), RANGE: 'SYSTEM_DEFAULT', FROM_PROFILES: '1'},
        ),
        ({PROFILES: 'mine.xml'}, {}),
        ({FROM_PROFILES: '0', TRANSPORTS: 'DEFAULT'}, {}),
    ],
)
def test_profiles_of_the_user_stay(given: dict[str, str], changed: dict[str, str]) -> None:
    environment = dict(given)
    for _ in range(2):  # as a process does whose parent did
        use_sockets(environment, FASTRTPS)
        release_buffers(environment, FASTRTPS)
        assert environment == given | changed


def test_other_middleware_is_left_alone() -> None:
    environment: dict[str, str] = {}
    release_buffers(environment, 'rmw_cyclonedds_cpp')
    assert environment == {}


def test_both_profiles_say_the_same_of_readers_and_writers() -> None:
    def endpoints(file: Path) -> list[bytes]:
        profiles = ElementTree.parse(file).getroot()
        return [ElementTree.tostring(p).strip() for p in profiles if 'data_' in p.tag]

    assert len(endpoints(BUFFERS)) == 2
    assert endpoints(LOCALHOST) == endpoints(BUFFERS)


@pytest.mark.ros
@pytest.mark.parametrize('transport', ['sockets', 'shared'])
def test_a_publisher_knows_within_a_second_that_its_messages_arrived(
    graph: Any, transport: str
) -> None:
    """With a heartbeat every 3 s it knew this once in a while."""
    arrived = graph.collect(String, 'small')
    command = [sys.executable, '-c', PUBLISHER, transport]
    with child(command, stdout=subprocess.PIPE) as publisher:
        graph.until(lambda: len(arrived) == 5 * 20)
        said, _ = publisher.communicate(timeout=60.0)
    assert said.split() == ['True'] * 5


@pytest.mark.ros
@pytest.mark.parametrize('transport', ['sockets', 'shared'])
def test_memory_of_large_messages_is_given_back(graph: Any, transport: str) -> None:
    """Each place of the history kept the largest message it ever held: 10 MB here."""

    def heap_after(size: int) -> int:
        """Return the listener's heap [bytes] once it has read messages of so many bytes."""
        for _ in range(MESSAGES):
            publisher.publish(String(data='x' * size))
        assert publisher.wait_for_all_acked(Duration(seconds=60))
        assert listener.stdout is not None
        print('read', file=listener.stdin, flush=True)
        count, heap = map(int, listener.stdout.readline().split())
        assert count == MESSAGES
        return heap

    command = [sys.executable, '-c', LISTENER, transport]
    with child(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as listener:
        publisher = graph.publisher(String, 'large', MESSAGES)
        before = heap_after(10)
        assert heap_after(SIZE) - before < 0.2 * MESSAGES * SIZE  # what else came meanwhile
        listener.communicate(timeout=60.0)
    assert listener.returncode == 1  # DenocError: it went through the end of a node


@pytest.mark.ros
def test_large_pieces_that_are_freed_go_back_to_the_system() -> None:
    """The heap kept 4 MB of them here, and more with each burst of large messages."""
    command = [sys.executable, '-c', KEEPER]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60.0)
    assert done.returncode == 1, done.stderr
    assert int(done.stdout) < 1_000_000


def test_a_threshold_of_the_user_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(CHOSEN, '1000000')
    assert not return_large_pieces()
