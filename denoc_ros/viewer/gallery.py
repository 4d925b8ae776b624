"""A choice of robots on one page."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import DenocError
from denoc_ros.viewer.page import Page


def offer(page: Page, names: Sequence[str], shown: str, load: Callable[[str], Robot]) -> None:
    """Put a list of robots on a page, each with sliders for its joints.

    Parameters
    ----------
    page : Page
    names : sequence of str
    shown : str
        The one that the page shows already.
    load : callable
        Returns a robot by its name.
    """
    gui = page.server.gui
    with gui.add_folder('Systems', order=-10.0):
        choice = gui.add_dropdown('Robot', tuple(names), initial_value=shown)
        text = gui.add_markdown('')

    def change(_: object) -> None:
        try:
            page.change_robot(load(choice.value))
        except DenocError as error:
            text.content = str(error)
            return
        text.content = ''
        page.pose()

    choice.on_update(change)
    page.pose()
