"""The command `pinav simulate`."""
