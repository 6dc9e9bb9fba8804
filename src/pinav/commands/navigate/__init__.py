"""The command `pinav navigate`."""
