"""The page in the browser: the robot as it bends, its controls and its charts."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

import rich
import viser

from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ConfigError
from denoc_ros.viewer.moment import Moment

LOOPBACK = ('127.0.0.1', 'localhost', '::1')


class Page:
    """A web page that shows a robot, served from this process.

    Nothing is loaded from elsewhere, and nothing is drawn while no browser looks.

    Parameters
    ----------
    robot : Robot
        Copied: it may go on being used by the caller's thread.
    host : str
        The interface to listen on; beyond loopback everybody who reaches it can look and click.
    port : int
        0 takes a free one.
    title : str
        Above the controls; default the robot's name.
    scale : float
        What the deflection is drawn larger by at first.
    folder : path, optional
        Where relative names of mesh files start.

    Attributes
    ----------
    address : str
        What a browser opens.

    Raises
    ------
    ConfigError
        The address cannot be listened on.
    """

    def __init__(
        self,
        robot: Robot,
        host: str = '127.0.0.1',
        port: int = 0,
        title: str = '',
        scale: float = 1.0,
        folder: Path | None = None,
    ) -> None:
        _check_address(host, port)
        rich.get_console().quiet = True  # viser prints its banner through it
        self._robot = robot.copy()
        self._server = viser.ViserServer(host, port, label=title or robot.tree.name, verbose=False)
        shown = f'[{host}]' if ':' in host else host
        self.address = f'http://{shown}:{self._server.get_port()}'

    @property
    def clients(self) -> int:
        """Number of browsers that look."""
        return len(self._server.get_clients())

    def show(self, moment: Moment) -> None:
        """Draw an instant; cheap, and next to nothing while no browser looks.

        Any thread may call it, but one at a time.
        """

    def play(self, moments: Sequence[Moment]) -> None:
        """Offer a recorded run: play, pause, scrub."""

    def close(self) -> None:
        """Stop serving; a second call does nothing."""
        self._server.stop()

    def __enter__(self) -> Page:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _check_address(host: str, port: int) -> None:
    """Raise ConfigError where nobody can listen: the server would try one port after another."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        with contextlib.closing(socket.socket(family, kind, protocol)) as trial:
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            trial.bind(address)
    except (OSError, OverflowError) as error:
        reason = getattr(error, 'strerror', None) or error
        rule = 'host and port must be ones to listen on'
        raise ConfigError('page', [f'{rule}, got {host!r}, {port}: {reason}']) from error
