"""Drive the robots by hand and watch the estimates (needs the extra `render`)."""

from relloc_env.play.session import Session
from relloc_env.play.window import play

__all__ = ["Session", "play"]
