"""Knowledge of state and force while a swimmer is observed, frame by frame."""
