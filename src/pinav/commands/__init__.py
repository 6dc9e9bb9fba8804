"""The commands of `pinav`, one folder each."""
