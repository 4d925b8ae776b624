"""The section of a report with snapshots of the robot."""

from __future__ import annotations

import base64
import io
from pathlib import Path
from typing import TYPE_CHECKING

from markupsafe import Markup

from denoc_ros.errors import DenocError

if TYPE_CHECKING:
    from PIL.Image import Image

    from denoc_ros.dynamics.robot import Robot
    from denoc_ros.reports.pages import PageSection

SIZE = (460, 360)  # pixels of one moment: readable at a phone's width
RATE = 20.0  # Hz, of the moments that are read: few are shown
COUNT = 6


def moments(bag: Path, robot: Robot | None) -> PageSection | None:
    """Return the section, None where the bag does not show how the robot stood."""
    from denoc_ros.reports.pages import PageSection
    from denoc_ros.viewer.film import Look, moment_images
    from denoc_ros.viewer.recorded import RecordedRun

    if robot is None:
        return None
    try:
        run = RecordedRun(bag, robot, rate=RATE)
        images = moment_images(run, robot, Look(size=SIZE), COUNT)
    except DenocError:
        return None
    shown = Markup('').join(
        Markup('<img alt="{}" width="{}" height="{}" src="data:image/png;base64,{}">').format(
            f'{robot.tree.name} at moment {k} of {COUNT} of the run', *image.size, _png(image)
        )
        for k, image in enumerate(images, 1)
    )
    said = (
        'The deflection is exaggerated by the factor in the pictures, the strain is not. '
        'For a film of the run: denoc view RUN --video FILE.mp4'
    )
    return PageSection('How it moved', said, picture=shown)


def _png(image: Image) -> str:
    picture = io.BytesIO()
    image.save(picture, 'png', optimize=True)
    return base64.b64encode(picture.getvalue()).decode()
