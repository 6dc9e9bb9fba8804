"""The command `pinav study`."""
