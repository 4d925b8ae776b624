"""The section of a report with snapshots of the robot."""

from __future__ import annotations

import base64
import io
from pathlib import Path
from typing import TYPE_CHECKING

from markupsafe import Markup

from denoc_ros.errors import DenocError

if TYPE_CHECKING:
    from denoc_ros.dynamics.robot import Robot
    from denoc_ros.reports.pages import PageSection

SIZE = (1200, 640)  # pixels, at most
RATE = 20.0  # Hz, of the moments that are read: few are shown
COUNT = 6


def moments(bag: Path, robot: Robot | None) -> PageSection | None:
    """Return the section, None where the bag does not show how the robot stood."""
    from denoc_ros.reports.pages import PageSection
    from denoc_ros.viewer.film import Look, strip_image
    from denoc_ros.viewer.recorded import RecordedRun

    if robot is None:
        return None
    try:
        run = RecordedRun(bag, robot, rate=RATE)
        image = strip_image(run, robot, Look(size=SIZE), COUNT)
    except DenocError:
        return None
    picture = io.BytesIO()
    image.save(picture, 'png', optimize=True)
    text = base64.b64encode(picture.getvalue()).decode()
    label = f'{robot.tree.name} at {COUNT} moments of the run'
    shown = Markup(
        '<img class="picture" alt="{}" width="{}" height="{}" src="data:image/png;base64,{}">'
    ).format(label, *image.size, text)
    said = (
        'The deflection is exaggerated by the factor in the picture, the strain is not. '
        'For a film of the run: denoc view RUN --video FILE.mp4'
    )
    return PageSection('How it moved', said, picture=shown)
