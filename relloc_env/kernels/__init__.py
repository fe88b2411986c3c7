"""The equations, each written once, as compiled kernels without units or checks.

Everything above calls these: environments, estimators, log replay, tests. Shapes and ranges are checked in the caller.
Frames and symbols are those of docs/equations.md; after Rodrigues et al., IROS 2019 ([RMDA19]).
"""
