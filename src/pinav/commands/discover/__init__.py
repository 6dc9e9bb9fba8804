"""The command `pinav discover`."""
