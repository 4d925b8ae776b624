"""Optional part: feedback of joints and sensors about a planned motion."""
