"""The robot of a recording: the file that was given, else the description in the bag."""

from __future__ import annotations

from pathlib import Path

from denoc_ros.cli.session.session_config import find_file
from denoc_ros.simulation.recorded.run_files import recorded_description


def robot_source(bag: Path, given: str | None) -> str | Path:
    """Return the file of the robot that was given, else the text of the recorded one.

    Raises
    ------
    BagError
        None was given and the bag has none.
    """
    if given is not None:
        return find_file(Path(given), Path()) or Path(given)
    return recorded_description(bag)
