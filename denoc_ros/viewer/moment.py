"""The name under which users' programs import a snapshot."""

from denoc_ros.simulation.recorded.snapshot import Snapshot as Moment

__all__ = ['Moment']
