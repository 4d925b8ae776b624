"""Pages and texts of `denoc identify`."""
