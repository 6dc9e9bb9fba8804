"""Search for the structure of a force: terms that the evidence prefers to none."""
