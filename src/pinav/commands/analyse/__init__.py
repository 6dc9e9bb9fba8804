"""The command `pinav analyse`."""
