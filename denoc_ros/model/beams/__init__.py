"""Beams: sections, shape functions, segments and links from files."""
