"""Fast DDS as the nodes use it: sockets, and buffers that go back to the system once read.

Fast DDS sends to processes of the same machine through queues in shared memory, with locks that
sender and receiver share. A receiver that is stopped, killed or just joins holds them, and the
sender's `publish` waits: seconds were measured (docs/trust.md). Sockets have no such locks, and
cost the same processor time.

rmw_fastrtps has Fast DDS keep received messages: each place of a history keeps the largest that
it ever held, so that a node grows with the largest messages, by up to their size times the depth
of each topic. Fast DDS also has the policy DYNAMIC, which allocates for each message what it takes
and frees it; only a profile can ask for it.

A reliable reader learns what it has lost from the writer's heartbeat, by default every 3 s. Until
then it has nothing that came after the lost one, and a node that ends does not know whether its
last messages arrived. The same profile has a heartbeat every 0.1 s.

A reader asks for what it has lost at each heartbeat. One that waits for a core loses messages
faster than it reads them, and what is sent again fills its socket anew, for minutes. So the
profile sends a message again after 0.2 s at the earliest, and asks for large sockets.
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
BUFFERS = Path(__file__).with_name('buffers.xml')
FROM_PROFILES = 'RMW_FASTRTPS_USE_QOS_FROM_XML'


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


def release_buffers(
    environment: MutableMapping[str, str] = os.environ, middleware: str | None = None
) -> None:
    """Have this process's endpoints use the profile, unless the user has profiles.

    Call it after `use_sockets`, whose profile says the same.

    Parameters
    ----------
    environment, middleware
        As of `use_sockets`.
    """
    if not is_fast_dds(middleware) or FROM_PROFILES in environment:
        return
    if environment.get(PROFILES) != str(LOCALHOST):
        if has_profiles(environment):
            return
        environment[PROFILES] = str(BUFFERS)
    environment[FROM_PROFILES] = '1'
