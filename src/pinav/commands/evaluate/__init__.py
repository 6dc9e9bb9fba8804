"""The command `pinav evaluate`."""
