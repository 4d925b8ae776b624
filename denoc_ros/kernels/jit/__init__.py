"""Compilation, cache and calls of kernels."""
