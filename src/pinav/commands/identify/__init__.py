"""The command `pinav identify`."""
