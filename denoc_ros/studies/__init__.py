"""Studies of the book and benchmarks; no other room imports them."""
