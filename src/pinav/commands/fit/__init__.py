"""The command `pinav fit`."""
