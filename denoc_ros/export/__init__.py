"""Optional part: a robot as the model of another simulator."""
