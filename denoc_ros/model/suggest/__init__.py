"""A `<flexibility>` block proposed for a plain URDF."""
