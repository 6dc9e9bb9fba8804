"""Trajectory matching: minimise a loss by phases of gradient steps."""
