"""Figures of the documentation that explain the problem: `python -m docs.figures` draws them anew."""
