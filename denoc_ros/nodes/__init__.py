"""The ROS 2 nodes: the only importers of rclpy."""

from denoc_ros.runtime.loop.ending import begin

# before the imports of a node, which take seconds
begin()
