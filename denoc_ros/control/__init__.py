"""Motions that leave no swing: tip-exact, input shapers, rest to rest; state feedback."""
