"""Proposed `<flexibility>` blocks for a plain URDF."""
