"""Plans: time-to-go by value iteration."""
