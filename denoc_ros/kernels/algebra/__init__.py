"""Vectors, rotations, spatial matrices and filters of kernels."""
