"""The command `pinav inspect`."""
