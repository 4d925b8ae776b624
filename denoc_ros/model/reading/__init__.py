"""Reading of a description: URDF, `<flexibility>`, meshes; findings."""
