"""Publishers and subscriptions without events of the middleware."""

from __future__ import annotations

from typing import Any

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node


class WithoutEvents(Node):
    """A node that no event of the middleware can hold up.

    Taking an event (rmw_fastrtps 8.4.3) locks the event and then the reader, while a thread that
    receives, and tells of a lost message or a publisher that does not fit, locks them the other
    way round: under load the executor stops for good, and with it all that the process receives.
    """

    def create_subscription(self, *given: Any, **options: Any) -> Any:
        """Subscribe as rclpy does."""
        events = SubscriptionEventCallbacks(use_default_callbacks=False)
        return super().create_subscription(*given, event_callbacks=events, **options)

    def create_publisher(self, *given: Any, **options: Any) -> Any:
        """Publish as rclpy does."""
        events = PublisherEventCallbacks(use_default_callbacks=False)
        return super().create_publisher(*given, event_callbacks=events, **options)
