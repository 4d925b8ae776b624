"""A process that does long computations for a node."""
