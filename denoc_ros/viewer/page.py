"""The page in the browser: the robot as it bends, a choice of robots, and who may use it."""

from __future__ import annotations

import contextlib
import http
import ipaddress
import logging
import math
import socket
import threading
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import urlsplit

import numpy as np
import rich
import viser
import websockets.asyncio.server
from viser import _messages

from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.validation import as_states
from denoc_ros.errors import ConfigError, DenocError, StateError
from denoc_ros.simulation.recorded.snapshot import Snapshot
from denoc_ros.viewer.charts import Charts
from denoc_ros.viewer.folders import JointSliders, ModePlayer, Playback, start_configuration
from denoc_ros.viewer.page_text import PageText
from denoc_ros.viewer.view import Controls, View, ViewOptions

MOST_PORT = 65535
FACED = 20  # moments of a run that the camera is to see
LOOPBACK = ('127.0.0.1', 'localhost', '::1')
_SERVING = threading.Lock()


class _Server(viser.ViserServer):
    """A server that never opens a tunnel to a public one, whoever asks for it."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        return None


class Page:
    """A web page that shows a robot, served from this process.

    Nothing is loaded from elsewhere, and nothing is drawn while no browser looks. Any thread may
    call its methods.

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
        What deflections are drawn larger by at first, 1 to 100.
    folder : path, optional
        Where relative names of mesh files start.
    origins : collection of str
        Host names of other pages that may open this one's socket.

    Attributes
    ----------
    address : str
        What a browser opens.
    server : viser.ViserServer
        For further controls.

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
        origins: Collection[str] = (),
    ) -> None:
        _check_address(host, port)
        rich.get_console().quiet = True  # viser prints its banner through it
        # who connects and speaks no HTTP is logged with a traceback else
        logging.getLogger('websockets.server').setLevel(logging.CRITICAL)
        self._lock = threading.RLock()
        self._title = title
        with checking_origins(origins):
            self.server = _Server(host, port, label=title or robot.tree.name, verbose=False)
        check_values(self.server)
        shown = f'[{host}]' if ':' in host else host
        self.address = f'http://{shown}:{self.server.get_port()}'
        gui = self.server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, control_width='medium')
        self._controls = Controls(gui, ViewOptions(scale=scale), self._redraw)
        self._charts = Charts(gui)
        self._panel: Playback | JointSliders | None = None
        self._player: ModePlayer | None = None
        self._adopt(robot, folder)
        self.server.on_client_connect(lambda _: self._redraw())

    @property
    def clients(self) -> int:
        """Number of browsers that look."""
        return len(self.server.get_clients())

    def show(self, moment: Snapshot) -> None:
        """Draw an instant; cheap, and next to nothing while no browser looks.

        Raises
        ------
        StateError
            Its coordinates are not this robot's, or not finite.
        """
        with self._lock:
            self._check(moment)
            self._charts.add(moment.t, moment.channels)
            self._present(moment)

    def play(self, run: Sequence[Snapshot]) -> None:
        """Offer a recorded run to be played and scrubbed.

        Raises
        ------
        StateError
            It has no moments, or not this robot's.
        """
        if not len(run):
            raise StateError('page: a run must have moments, got none')
        self._check(run[0])
        with self._lock:
            self._close_panel()
            playback = Playback(
                self.server.gui, run, self._show_recorded, lambda: self.clients > 0
            )
            chosen = np.linspace(0, len(run) - 1, FACED).astype(int)
            self._view.face(np.array([run[int(k)].q for k in chosen]))
            names = list(run[0].channels)
            values = [[moment.channels.get(name, np.nan) for name in names] for moment in run]
            self._charts.record(playback.times, names, np.array(values))
            self._panel = playback
        playback.show()

    def record(self, run: Sequence[Snapshot], fps: float) -> str:
        """Draw a run frame by frame; return the HTML that plays it, see :func:`recorded_page`."""
        with self._lock:
            recorder = self.server.get_scene_serializer()
            self._view.face(np.array([moment.q for moment in run]))
            for moment in run:
                self._check(moment)
                self._view.draw(moment, self._controls.look)
                recorder.insert_sleep(1.0 / fps)
            return str(recorder.as_html())

    def pose(self, joints: Mapping[str, float] | None = None) -> None:
        """Offer sliders for the joints, at first at positions given by name [rad, m], or zero.

        Of a mechanism only as many as move by themselves: the rest follows.

        Raises
        ------
        StateError
            A name is none of a joint.
        """
        with self._lock:
            self._close_panel()
            start = start_configuration(self._view.robot, joints)
            self._view.face(start[None])
            sliders = JointSliders(self.server.gui, self._view.robot, start, self.show)
            self._panel = sliders
        sliders.move()

    def change_robot(self, robot: Robot) -> None:
        """Show another robot; its run or its sliders have to be asked for anew."""
        with self._lock:
            self._close_panel()
            self._adopt(robot, None)

    def close(self) -> None:
        """Stop serving; a second call does nothing."""
        with self._lock:
            self._close_panel()
            if self._player is not None:
                self._player.close()
                self._player = None
                self.server.stop()

    def __enter__(self) -> Page:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def _adopt(self, robot: Robot, folder: Path | None) -> None:
        if self._player is not None:
            self._player.close()
        self.server.scene.reset()
        self.server.gui.set_panel_label(self._title or robot.tree.name)
        self._view = View(self.server, robot.copy(), folder)
        self._moment = Snapshot(0.0, start_configuration(self._view.robot))
        self._view.face(self._moment.q[None])
        self._player = ModePlayer(
            self.server.gui, robot, lambda: self._moment.q, self._draw_mode, self._leave_mode
        )
        self._redraw()

    def _close_panel(self) -> None:
        if self._panel is not None:
            self._panel.close()
            self._panel = None
        self._charts.clear()

    def _check(self, moment: Snapshot) -> None:
        as_states('q', moment.q, self._view.robot.n)
        if not np.isfinite(moment.q).all():
            raise StateError('page: coordinates must be finite, got some that are not')

    def _show_recorded(self, moment: Snapshot) -> None:
        with self._lock:
            self._charts.point(moment.t)
            self._present(moment)

    def _present(self, moment: Snapshot) -> None:
        self._moment = moment
        if self._player is None or not self._player.playing:
            self._draw(moment, self._controls.look)

    def _draw_mode(self, moment: Snapshot) -> None:
        with self._lock:
            if self._player is not None and self._player.playing:
                # its amplitude is chosen to be seen: nothing is to make it larger
                self._draw(moment, replace(self._controls.look, scale=1.0))

    def _leave_mode(self) -> None:
        with self._lock:
            self._view.forget_strain()
            self._present(self._moment)

    def _redraw(self) -> None:
        with self._lock:
            self._present(self._moment)

    def _draw(self, moment: Snapshot, look: ViewOptions) -> None:
        if not self.clients:
            return
        with self.server.atomic():
            self._controls.explain(self._view.draw(moment, look))
            self._charts.draw()


class RecordedPage(str):
    """One page of HTML with a robot that moves; notebooks show it as such.

    Everything it needs is in it, so that it can be kept, sent and opened without a server.
    """

    def _repr_html_(self) -> str:
        return str(self)


def recorded_page(
    robot: Robot,
    run: Sequence[Snapshot],
    scale: float = 1.0,
    fps: float = 20.0,
    folder: Path | None = None,
) -> RecordedPage:
    """Make one page of HTML that plays a run.

    Parameters
    ----------
    robot : Robot
        Its workspace is used.
    run : sequence of Snapshot
        What is drawn, one frame each.
    scale : float
        What deflections are drawn larger by.
    fps : float
        Frames per second [Hz].

    Returns
    -------
    RecordedPage
        The text of the page, about 1 MB.

    Raises
    ------
    StateError
        The run has no moments, or coordinates that are not this robot's or not finite.
    ConfigError
        `fps` is not positive.
    """
    if not fps > 0.0:
        raise ConfigError('page', [f'fps must be > 0 Hz, got {fps}'])
    if not len(run):
        raise StateError('page: a run must have moments, got none')
    with Page(robot, scale=scale, folder=folder) as page:
        return RecordedPage(page.record(run, fps))


def _check_address(host: str, port: int) -> None:
    """Raise ConfigError where nobody can listen: the server would try one port after another."""
    if not 0 <= port <= MOST_PORT:  # looking it up would take it modulo 65536
        raise ConfigError('page', [f'port must be 0 to {MOST_PORT}, got {port}'])
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        with contextlib.closing(socket.socket(family, kind, protocol)) as trial:
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            trial.bind(address)
    except OSError as error:
        reason = getattr(error, 'strerror', None) or error
        rule = 'host and port must be ones to listen on'
        raise ConfigError('page', [f'{rule}, got {host!r}, {port}: {reason}']) from error


class Exhibit(NamedTuple):
    """A robot and the joint positions by name [rad, m] that it is shown at first."""

    robot: Robot
    joints: Mapping[str, float]


def offer(page: Page, names: Sequence[str], shown: str, load: Callable[[str], Exhibit]) -> None:
    """Put a list of robots on a page, each with sliders for its joints."""
    gui = page.server.gui
    with gui.add_folder('Systems', order=-10.0):
        choice = gui.add_dropdown('Robot', tuple(names), initial_value=shown)
        text = PageText(gui)

    def change() -> None:
        try:
            exhibit = load(choice.value)
            page.change_robot(exhibit.robot)
            page.pose(exhibit.joints)
        except DenocError as error:
            text.show(str(error))
            return
        text.show('')

    choice.on_update(lambda _: change())
    change()


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
    if name in LOOPBACK or name in allowed:
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
    """Say whether a control can take the values of a browser's message."""
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
