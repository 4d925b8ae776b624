"""A whole model from recorded runs: stiffness, payload, inertia, friction, gains, delays."""
