"""The log of a node, whose lines quote names from messages and files."""

from __future__ import annotations

import os
from typing import Any

from rclpy.impl import rcutils_logger

from denoc_ros.terminal_text import visible

# A line is logged with the place that it comes from: the caller of this file.
rcutils_logger._internal_callers.append(os.path.realpath(__file__))


class VisibleLog:
    """A logger of rclpy that shows control characters.

    Parameters
    ----------
    logger : RcutilsLogger
        Takes the lines; what else it can do is done by it.
    """

    def __init__(self, logger: Any) -> None:
        self._logger = logger

    def __getattr__(self, name: str) -> Any:
        return getattr(self._logger, name)

    def debug(self, message: object, **options: Any) -> Any:
        """Log a line for developers."""
        return self._logger.debug(visible(str(message)), **options)

    def info(self, message: object, **options: Any) -> Any:
        """Log an event."""
        return self._logger.info(visible(str(message)), **options)

    def warning(self, message: object, **options: Any) -> Any:
        """Log a doubt."""
        return self._logger.warning(visible(str(message)), **options)

    def error(self, message: object, **options: Any) -> Any:
        """Log a failure."""
        return self._logger.error(visible(str(message)), **options)

    def fatal(self, message: object, **options: Any) -> Any:
        """Log what ends the process."""
        return self._logger.fatal(visible(str(message)), **options)
