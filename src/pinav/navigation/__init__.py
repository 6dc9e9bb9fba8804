"""Planning and steering with a known or learned force."""
