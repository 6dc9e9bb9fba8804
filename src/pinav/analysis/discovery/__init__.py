"""Discovery of the law behind a learned force."""
