"""Buffers of received messages go back to the system once read; lost messages come again soon.

rmw_fastrtps has Fast DDS keep them: each place of a history keeps the largest message that it ever
held, so that a node grows with the largest messages, by up to their size times the depth of each
topic. Fast DDS also has the policy DYNAMIC, which allocates for each message what it takes and
frees it; only a profile can ask for it.

A reliable reader learns what it has lost from the writer's heartbeat, by default every 3 s. Until
then it has nothing that came after the lost one, and a node that ends does not know whether its
last messages arrived. The same profile has a heartbeat every 0.1 s.
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
