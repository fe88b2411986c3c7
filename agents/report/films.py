"""One episode of an agent as a small moving picture that stands in the page itself."""

import base64
import io
from dataclasses import replace

from agents.jobs import Job
from agents.policy import Task
from agents.registry import make, refuse_agents
from agents.rollout import rollout
from relloc_env.envs.parallel import RellocParallelEnv
from relloc_env.extras import extra
from relloc_env.places import refuse_code

with extra("agents"):
    from PIL import Image


SMALLER = 2
"""Times as small as the environment's own picture, which is 960 px wide."""
EVERY = 2
"""Actions between two pictures."""
FASTER = 4.0
"""Times as fast as the robots."""
PAUSE = 1.5
"""[s] that the last picture stays."""


def film(job: Job, *, trust: bool = False) -> str:
    """A data URI of the first episode of a job, drawn.

    Raises:
        UntrustedError: code would run that the job names, without `trust`.
    """
    config, seeds = replace(job, episodes=1).configurations()[0]
    if not trust:
        refuse_agents([job.agent], "The folder")
        refuse_code(config.to_dict(), "The folder")
    env = RellocParallelEnv(config, bound=True, render_mode="rgb_array")
    episode = rollout(env, make(job.agent, Task.of(env)), seeds[0], frames=True)
    env.close()
    frames = [Image.fromarray(frame) for frame in episode.frames[::EVERY]]
    pages = [frame.reduce(SMALLER) for frame in frames]
    period = round(1e3 * EVERY * float(episode.time[1]) / FASTER)
    lasting = [period] * (len(pages) - 1) + [round(1e3 * PAUSE)]
    buffer = io.BytesIO()
    pages[0].save(
        buffer, "WEBP", save_all=True, append_images=pages[1:], duration=lasting, loop=0, quality=70, method=2
    )
    return "data:image/webp;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")
