"""Damping and frequencies from measured records: decays, spectra, joints, forced responses."""
