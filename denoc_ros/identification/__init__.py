"""Identification from measured records: decays, spectra, joints, servos, whole models."""
