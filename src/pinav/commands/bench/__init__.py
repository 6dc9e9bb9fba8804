"""The command `pinav bench`."""
