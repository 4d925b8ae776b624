"""Access control of a page: its own origin only, and valid values."""

from __future__ import annotations

import http
import ipaddress
import math
import socket
import threading
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

import viser
import websockets.asyncio.server
from viser import _messages

LOCAL = ('localhost', '127.0.0.1', '::1')
_SERVING = threading.Lock()


def is_welcome(origin: str | None, host: str | None, allowed: Collection[str]) -> bool:
    """Say whether a web page may open a socket to this one.

    A browser sends the address of the page whose script asks: without this, any page that is open
    beside ours could press its buttons.

    Parameters
    ----------
    origin : str or None
        What the request says of the page; None: it is no browser's.
    host : str or None
        What the request calls this server.
    allowed : collection of str
        Host names besides those of this machine's loopback.
    """
    if origin is None:
        return True
    try:
        name = urlsplit(origin).hostname
        called = urlsplit(f'//{host or ""}').hostname
    except ValueError:
        return False
    if not name:
        return False
    if name in LOCAL or name in allowed:
        return True
    # our own page under this machine's address; a name could be anybody's, made to lead here
    own = socket.gethostname().lower()
    return name == called and (_is_address(name) or name in (own, f'{own}.local'))


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


@contextmanager
def checking_origins(allowed: Collection[str]) -> Iterator[None]:
    """Let the server that viser starts in this block refuse the pages of others."""
    serve = websockets.asyncio.server.serve

    def checked(*given: Any, process_request: Callable[..., Any], **options: Any) -> Any:
        def on_request(connection: Any, request: Any) -> Any:
            headers = request.headers
            if is_welcome(headers.get('Origin'), headers.get('Host'), allowed):
                return process_request(connection, request)
            return connection.respond(http.HTTPStatus.FORBIDDEN, 'another page\n')

        return serve(*given, process_request=on_request, **options)

    with _SERVING:  # viser offers no hook: it calls this function, by its module, as it starts
        websockets.asyncio.server.serve = checked  # type: ignore[misc, assignment]
        try:
            yield
        finally:
            websockets.asyncio.server.serve = serve  # type: ignore[misc]


def check_values(server: viser.ViserServer) -> None:
    """Let the controls of a server take possible values only: viser sets whatever comes."""
    gui, interface = server.gui, server._websock_server
    handle_update = gui._handle_gui_updates

    async def on_update(client: Any, message: Any) -> None:
        control = gui._gui_input_handle_from_uuid.get(message.uuid)
        if control is not None and is_possible(control, message.updates):
            await handle_update(client, message)

    interface.unregister_handler(_messages.GuiUpdateMessage, handle_update)
    interface.register_handler(_messages.GuiUpdateMessage, on_update)


def is_possible(control: Any, updates: Any) -> bool:
    """Say whether a control can take the values of a browser's message.

    Parameters
    ----------
    control : viser handle
        A slider, checkbox, list of choices or button.
    updates : mapping
        By the name of what is changed.
    """
    if not isinstance(updates, dict) or set(updates) != {'value'}:
        return False
    value, now = updates['value'], control.value
    if isinstance(now, bool):
        return isinstance(value, bool)
    if isinstance(now, (int, float)):
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        return number and math.isfinite(value) and control.min <= value <= control.max
    options = getattr(control, 'options', ())
    return isinstance(value, str) and value in options
