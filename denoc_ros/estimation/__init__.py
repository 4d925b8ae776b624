"""Estimation of deflections from measured joints: the real-time side, without ROS."""
