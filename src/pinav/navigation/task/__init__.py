"""Navigation problems: start, goal, zones, limits of the commands."""
