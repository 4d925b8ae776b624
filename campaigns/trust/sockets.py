"""What may come to the viewer's page that no browser sends."""

from __future__ import annotations

import socket
from contextlib import suppress
from typing import Any
from urllib.parse import urlsplit

import msgspec
from trust.adversary import Adversary
from viewer_client import CAMERA, ViewerClient
from websockets.exceptions import WebSocketException

# messages of a viser client, with fields that each must have
KINDS = (
    'ViewerCameraMessage', 'GuiUpdateMessage', 'ScenePointerMessage', 'SceneNodeClickMessage',
    'TransformControlsUpdateMessage', 'GuiCloseModalMessage', 'ShareUrlRequest', 'Nothing',
    'GetRenderResponseMessage', 'FileTransferStartUpload', 'FileTransferPart',
)  # fmt: skip
RAW = (
    b'GET / HTTP/1.1\r\nHost: x\r\n\r\n',
    b'GET /../../etc/passwd HTTP/1.1\r\n\r\n',
    b'POST / HTTP/1.1\r\nContent-Length: 99999999999\r\n\r\n',
    b'\x16\x03\x01' + b'\xff' * 200,
    b'GET / HTTP/1.1\r\n' + b'X: y\r\n' * 2000 + b'\r\n',
    b'',
)


def plain(rng: Adversary, depth: int = 0) -> Any:
    """Return a value of any kind that a message may carry."""
    kinds = 9 if depth < 2 else 7
    draw = int(rng.rng.integers(kinds))
    if draw == 7:
        return [plain(rng, depth + 1) for _ in range(rng.count() % 8)]
    if draw == 8:
        return {rng.text()[:50]: plain(rng, depth + 1) for _ in range(3)}
    simple = (
        None,
        rng.chance(0.5),
        rng.integer(32, True),
        rng.real(),
        rng.real(),
        rng.text(),
        b'\xff',
    )
    return simple[draw]


def message(rng: Adversary, controls: list[str]) -> Any:
    """Return one message: often about a control of the page that there is."""
    if rng.chance(0.1):
        return plain(rng)
    if controls and rng.chance(0.6):
        value = {rng.one_of(('value', 'value', 'visible', 'x')): plain(rng)}
        return {'type': 'GuiUpdateMessage', 'uuid': rng.one_of(controls), 'updates': value}
    made = {'type': rng.one_of(KINDS)}
    for key in ('uuid', 'updates', 'wxyz', 'position', 'fov', 'name', 'content', 'part_index'):
        if rng.chance(0.6):
            made[key] = plain(rng)
    return {**CAMERA, rng.one_of(list(CAMERA)): plain(rng)} if rng.chance(0.3) else made


def attack_page(address: str, rng: Adversary, count: int) -> int:
    """Send so many messages to a page, which may hang up; return how many left."""
    if rng.chance(0.2):
        return _raw(address, rng)
    sent = 0
    while sent < count:
        with suppress(OSError, WebSocketException):
            client = ViewerClient(address)
            try:
                told = [each for _ in range(3) for each in client.receive(0.1)]
                controls = [each['uuid'] for each in told if isinstance(each.get('uuid'), str)]
                while sent < count:
                    sent += 1
                    raw = msgspec.msgpack.encode(message(rng, controls))
                    client.send_raw(
                        raw[: int(rng.rng.integers(len(raw) + 1))] if rng.chance(0.1) else raw
                    )
                client.receive(0.1)
            finally:
                client.close()
        sent += 1  # a connection that is refused counts as well: this comes to an end
    return sent


def _raw(address: str, rng: Adversary) -> int:
    """Say to the page's port what is no websocket."""
    where = urlsplit(address)
    there = str(where.hostname), int(where.port or 0)
    for text in RAW:
        with (
            suppress(OSError),
            socket.create_connection(there, 1.0) as line,
        ):
            line.sendall(text if rng.chance(0.7) else rng.rng.bytes(500))
            line.settimeout(0.05)
            line.recv(100)
    return len(RAW)
