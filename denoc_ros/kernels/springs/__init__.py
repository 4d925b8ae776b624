"""Springs of elastic joints, and the dynamics seen from the links behind them."""
