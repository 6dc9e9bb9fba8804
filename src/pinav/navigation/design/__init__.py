"""Experiment design: which trajectory to record next."""
