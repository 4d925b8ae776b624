"""Buffers of received messages go back to the system once a message is read.

rmw_fastrtps has Fast DDS keep them: each place of a history keeps the largest message that it ever
held, so that a node grows with the largest messages, by up to their size times the depth of each
topic. Fast DDS also has the policy DYNAMIC, which allocates for each message what it takes and
frees it; only a profile can ask for it.
"""

from __future__ import annotations

import os
from collections.abc import MutableMapping
from pathlib import Path

from denoc_ros.nodes.sockets import LOCALHOST, PROFILES, has_profiles, is_fast_dds

BUFFERS = Path(__file__).with_name('buffers.xml')
FROM_PROFILES = 'RMW_FASTRTPS_USE_QOS_FROM_XML'


def release_buffers(
    environment: MutableMapping[str, str] = os.environ, middleware: str | None = None
) -> None:
    """Have this process's endpoints free the memory of messages, unless the user has profiles.

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
