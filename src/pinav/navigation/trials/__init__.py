"""Closed loops and their metrics."""
