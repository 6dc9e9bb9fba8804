"""The command `pinav compare`."""
