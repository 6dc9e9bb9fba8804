"""What stands for the unknown force, laid around the data."""
