"""Tables of the parameters of nodes."""
