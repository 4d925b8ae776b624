"""Seeing it: the page in the browser and films; the only importer of viser."""
