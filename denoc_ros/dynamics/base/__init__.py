"""Moving and floating bases."""
