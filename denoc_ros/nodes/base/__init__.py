"""What all nodes share: life cycle, inputs, messages, time."""
