"""The robot model: URDF + `<flexibility>` to the immutable tree, and its arrays."""
