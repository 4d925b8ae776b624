"""ROS domains of this machine: each that is claimed belongs to one test process at a time."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress

DOMAINS = range(20, 100)  # above 101 the ports would meet the ephemeral ones


@contextmanager
def claimed_domain() -> Iterator[int]:
    """Give a domain that no other test process has, and that `denoc up` takes for used."""
    for domain in DOMAINS:
        with ExitStack() as claims, suppress(OSError):
            name = claims.enter_context(socket.socket(socket.AF_UNIX))
            name.bind(f'\0denoc-ros-domain-{domain}')
            # where the first participant of a domain listens (RTPS 2.2, 9.6.1): the first to
            # come has the next port
            port = claims.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            port.bind(('', 7410 + 250 * domain))
            held = claims.pop_all()
            break
    else:
        raise RuntimeError('every ROS domain is taken by another test process')
    with held:
        yield domain
