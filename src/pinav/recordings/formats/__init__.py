"""Readers of trackers' files, one module for each format."""
