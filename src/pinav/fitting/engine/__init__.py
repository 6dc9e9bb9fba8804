"""Linearise, evidence, step, posterior: one iteration for whatever residuals."""
