"""The doors: PettingZoo, Gymnasium, and what they share."""
