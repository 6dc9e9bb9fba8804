"""Checks after a fit: what contradicts it, and by how much."""
