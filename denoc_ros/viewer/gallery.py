"""A choice of robots on one page."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import DenocError
from denoc_ros.viewer.page import Page


class Exhibit(NamedTuple):
    """A robot and the joint positions by name [rad, m] that it is shown at first."""

    robot: Robot
    joints: Mapping[str, float]


def offer(page: Page, names: Sequence[str], shown: str, load: Callable[[str], Exhibit]) -> None:
    """Put a list of robots on a page, each with sliders for its joints.

    Parameters
    ----------
    page : Page
    names : sequence of str
    shown : str
        The one to begin with.
    load : callable
        Returns a robot by its name.
    """
    gui = page.server.gui
    with gui.add_folder('Systems', order=-10.0):
        choice = gui.add_dropdown('Robot', tuple(names), initial_value=shown)
        text = gui.add_markdown('')

    def change() -> None:
        try:
            exhibit = load(choice.value)
            page.change_robot(exhibit.robot)
            page.pose(exhibit.joints)
        except DenocError as error:
            text.content = str(error)
            return
        text.content = ''

    choice.on_update(lambda _: change())
    change()
