"""Versions of the relevant packages, and the machine."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version

PACKAGES = ('denoc_ros', 'numpy', 'numba', 'rclpy', 'rmw_fastrtps_cpp', 'mcap', 'rosbags')


def versions() -> dict[str, str]:
    """Return names and versions, in the order a reader looks for them."""
    found = {'python': platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    found['system'] = f'{platform.system()} {platform.release()} {platform.machine()}'
    found['processors'] = str(os.cpu_count())
    return found
