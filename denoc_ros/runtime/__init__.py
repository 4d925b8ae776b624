"""The real-time part of the nodes without ROS: loop, safety, parameters, references, models."""
