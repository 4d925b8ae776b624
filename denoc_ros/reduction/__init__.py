"""Flexible links from finite elements: mesh, matrices, modes, and the file of the link."""
