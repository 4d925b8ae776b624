"""Optional part: motions without residual vibration."""
