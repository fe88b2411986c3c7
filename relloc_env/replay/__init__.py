"""Estimators on recorded logs: `replay` runs, scores, writes and draws."""

from relloc_env.replay.opening import open_logs
from relloc_env.replay.run import ReplayResult, Run, replay, run_estimator

__all__ = ["ReplayResult", "Run", "open_logs", "replay", "run_estimator"]
