"""The command `pinav heat`."""
