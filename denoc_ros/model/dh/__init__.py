"""Denavit-Hartenberg tables: read, checked, and written as URDF + `<flexibility>`."""
