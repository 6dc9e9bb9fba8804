"""The command `pinav reproduce`."""
