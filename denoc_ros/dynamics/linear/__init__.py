"""Linear models and natural modes of a robot."""
