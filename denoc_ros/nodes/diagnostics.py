"""/diagnostics, once a second: a node's statuses as messages."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from denoc_ros.nodes.guarding import Guard
from denoc_ros.runtime.status import WARN, Status


class DiagnosticsPublisher:
    """Publishes a node's statuses on /diagnostics."""

    def __init__(self, node: Any) -> None:
        self._node = node
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)

    def publish(self, statuses: Sequence[Status]) -> None:
        """Publish statuses, stamped now."""
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        name = self._node.get_fully_qualified_name().lstrip('/')
        message.status = [_message(name, status) for status in statuses]
        self._publisher.publish(message)


def _message(node: str, status: Status) -> DiagnosticStatus:
    return DiagnosticStatus(
        name=f'{node}: {status.name}',
        level=status.level,
        message=status.message,
        hardware_id=node,
        values=[KeyValue(key=key, value=_shown(value)) for key, value in status.values.items()],
    )


def _shown(value: object) -> str:
    return f'{value:.6g}' if isinstance(value, float) else str(value)


def callback_status(guard: Guard) -> Status:
    """Return which callbacks failed, and how often; warns of new failures."""
    status = Status('callbacks', values=dict(sorted(guard.failures.items())))
    failed = guard.failures.total()
    if failed > guard.reported:
        status.worsen(WARN, guard.last)
    guard.reported = failed
    return status
