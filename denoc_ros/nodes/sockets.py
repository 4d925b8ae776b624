"""Sockets instead of shared memory, so that no other process can hold up a node that publishes.

Fast DDS sends to processes of the same machine through queues in shared memory, with locks that
sender and receiver share. A receiver that is stopped, killed or just joins holds them, and the
sender's `publish` waits: seconds were measured (docs/trust.md). Sockets have no such locks, and
cost the same processor time.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, MutableMapping
from pathlib import Path

LOCALHOST = Path(__file__).with_name('sockets.xml')
RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
ONLY = 'ROS_LOCALHOST_ONLY'
TRANSPORTS = 'FASTDDS_BUILTIN_TRANSPORTS'
PROFILES = 'FASTRTPS_DEFAULT_PROFILES_FILE'
IMPLICIT_PROFILES = Path('DEFAULT_FASTRTPS_PROFILES.xml')  # Fast DDS reads it where it is started


def use_sockets(
    environment: MutableMapping[str, str] = os.environ, middleware: str | None = None
) -> None:
    """Restrict this process's participant to sockets, unless the user has chosen a transport.

    Parameters
    ----------
    environment : mapping
        Default the process's own, before the participant exists; changed in place.
    middleware : str, optional
        Identifier of the implementation, default that in use; others than Fast DDS are left alone.

    Notes
    -----
    With discovery on localhost rmw_fastrtps adds shared memory whatever is asked. So the node's
    own profile says then what localhost means, and discovery is left to it.
    """
    chosen = environment.get(TRANSPORTS) or has_profiles(environment)
    if chosen or not is_fast_dds(middleware):
        return
    if not _localhost(environment):
        environment[TRANSPORTS] = 'UDPv4'
    elif not environment.get('ROS_STATIC_PEERS'):  # which only that discovery reads
        environment[PROFILES] = str(LOCALHOST)
        environment[RANGE] = 'SYSTEM_DEFAULT'
        environment.pop(ONLY, None)


def is_fast_dds(middleware: str | None = None) -> bool:
    """Return whether the middleware, default that in use, is Fast DDS."""
    if middleware is None:
        from rclpy import get_rmw_implementation_identifier  # which tests without ROS have not

        middleware = str(get_rmw_implementation_identifier())
    return middleware.startswith('rmw_fastrtps')


def has_profiles(environment: Mapping[str, str]) -> bool:
    """Return whether a file of profiles has been chosen."""
    return bool(environment.get(PROFILES)) or IMPLICIT_PROFILES.exists()


def _localhost(environment: MutableMapping[str, str]) -> bool:
    """Return whether discovery is to stay on this machine; the older variable wins, as in rcl."""
    if environment.get(ONLY):
        return environment[ONLY] == '1'
    return environment.get(RANGE) == 'LOCALHOST'
