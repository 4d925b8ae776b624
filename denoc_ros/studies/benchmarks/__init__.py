"""The benchmark: results are checked first, then timed beside their peers in the same process."""
