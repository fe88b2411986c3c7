"""Training with Stable-Baselines3; run from a checkout: `python -m train run --help`."""
