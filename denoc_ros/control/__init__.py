"""Motions without residual vibration: tip-exact, input shapers, rest to rest; state feedback."""
