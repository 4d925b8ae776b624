"""Nodes on real DDS, on loopback, in the domain of this test session."""

from graph_fixtures import graph, urdf, watch

__all__ = ['graph', 'urdf', 'watch']
