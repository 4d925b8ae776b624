"""Robot: the verbs of the dynamics over kernels and one workspace."""
