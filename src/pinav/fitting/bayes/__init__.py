"""Bayesian fits: linearise, maximise the evidence, step."""
