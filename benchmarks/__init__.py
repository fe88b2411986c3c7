"""Speed of the environments beside that of others, measured in one run: `python -m benchmarks speed`."""
