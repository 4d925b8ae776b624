"""Bags: MCAP out, MCAP and db3 in, recovery; bytes and schemas, no ROS."""
