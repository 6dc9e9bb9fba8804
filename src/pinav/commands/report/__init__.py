"""The command `pinav report`."""
