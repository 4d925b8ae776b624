"""What a real-time node needs and no ROS: loop, safety, parameters, references, live models."""
