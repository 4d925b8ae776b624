"""What a robot is: URDF + `<flexibility>` to the immutable tree, and its arrays."""
