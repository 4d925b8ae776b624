"""Places of numbers in the arrays of kernels."""
