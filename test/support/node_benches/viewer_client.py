"""A client of the viewer's page that receives and does not draw.

`python -m viewer_client ADDRESS` counts updates until SIGINT and prints them as JSON.
"""

from __future__ import annotations

import json
import signal
import sys
import time
from contextlib import closing
from importlib.metadata import version
from typing import Any

import msgspec
import zstandard
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.typing import Subprotocol

MOVING = 'SceneNodeUpdateMessage'  # how the page tells of what moves
# a client counts from its first camera on
CAMERA = {
    'type': 'ViewerCameraMessage',
    'wxyz': (1.0, 0.0, 0.0, 0.0),
    'position': (3.0, 3.0, 3.0),
    'fov': 1.0,
    'near': 0.1,
    'far': 1000.0,
    'image_height': 360,
    'image_width': 480,
    'look_at': (0.0, 0.0, 0.0),
    'up_direction': (0.0, 0.0, 1.0),
}


class ViewerClient:
    """Says hello as a browser does, then only receives.

    Parameters
    ----------
    address : str
        Of the page: `http://host:port`.
    """

    def __init__(self, address: str) -> None:
        self._unpack = zstandard.ZstdDecompressor()
        self._socket = connect(
            address.replace('http', 'ws', 1),
            subprotocols=[Subprotocol(f'viser-v{version("viser")}')],
            compression=None,
            max_size=None,
            proxy=None,
        )
        self.send(CAMERA)

    def send(self, message: dict[str, Any]) -> None:
        """Send a message as a browser would."""
        self._socket.send(msgspec.msgpack.encode(message))

    def receive(self, timeout: float) -> list[dict[str, Any]]:
        """Return the next window of messages; none where there is none in time [s]."""
        try:
            raw = self._socket.recv(timeout)
        except TimeoutError:
            return []
        assert isinstance(raw, bytes)
        size, packed = (int.from_bytes(raw[k : k + 8], 'little') for k in (0, 8))
        plain = self._unpack.decompress(raw[16 : 16 + packed], max_output_size=size)
        return list(msgspec.msgpack.decode(plain)['messages'])

    def send_raw(self, raw: bytes) -> None:
        """Send bytes as no browser would."""
        self._socket.send(raw)

    def updates(self, seconds: float) -> int:
        """Return how often the robot moved in a time [s]."""
        end = time.perf_counter() + seconds
        count = 0
        while (left := end - time.perf_counter()) > 0.0:
            count += moves(self.receive(left))
        return count

    def close(self) -> None:
        self._socket.close()


def moves(messages: list[dict[str, Any]]) -> bool:
    """Say whether messages are an update of what is drawn."""
    return any(message['type'] == MOVING for message in messages)


def main() -> None:
    ended: list[int] = []
    signal.signal(signal.SIGINT, lambda number, _: ended.append(number))
    times = []
    with closing(ViewerClient(sys.argv[1])) as client:
        while not ended:
            try:
                if moves(client.receive(0.1)):
                    times.append(time.perf_counter())
            except ConnectionClosed:
                break
    print(json.dumps(times))


if __name__ == '__main__':
    main()
