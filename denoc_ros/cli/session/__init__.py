"""Sessions of `denoc up`."""
