"""Who is measured, at which numbers of environments, on how many cores."""

import importlib.metadata
from collections.abc import Callable
from dataclasses import dataclass

from benchmarks import ours, peers
from benchmarks.peers import Drive

SIZES = (1, 4, 16, 64, 256, 1024, 4096, 16384)
"""Numbers of environments of the plot."""
BATCH = 4096
"""Number of environments at which batches are compared."""


@dataclass(frozen=True)
class Contender:
    """An environment on so many cores: one process."""

    name: str
    set_up: Callable[[int], Drive]
    """Takes the number of environments."""
    package: str
    """Distribution that it comes with."""
    words: str
    """What it is, for tables."""
    sizes: tuple[int, ...] = SIZES
    cores: int | None = None
    """None for all that are measured with."""
    samples: int = 1
    """Samples in a step."""

    def headline(self, num_envs: int) -> bool:
        """Whether this size is in a comparison, rather than in the plot alone."""
        return num_envs in (1, BATCH) or len(self.sizes) == 1

    def version(self) -> str | None:
        """Installed version of its package; None where it is not installed."""
        try:
            return importlib.metadata.version(self.package)
        except importlib.metadata.PackageNotFoundError:
            return None


_OURS, _ONE, _BATCH = "relloc-env", (1,), (BATCH,)
CONTENDERS = {
    c.name: c
    for c in (
        Contender("parallel", ours.parallel_door, _OURS, "everything on, PettingZoo Parallel", _ONE, 1),
        Contender("gymnasium", ours.gymnasium_door, _OURS, "everything on, Gymnasium", _ONE, 1),
        Contender("everything", ours.everything, _OURS, "everything on, vector environment"),
        Contender("everything-1", ours.everything, _OURS, "everything on, vector environment", _BATCH, 1),
        Contender("with-info", ours.with_info, _OURS, "everything on, the truth in info as well", _BATCH),
        Contender("lossy-network", ours.lossy_network, _OURS, "everything on, messages late and lost", _BATCH),
        Contender("crowded", ours.crowded, _OURS, "everything on, ten times the contacts", _BATCH),
        Contender("default", ours.default, _OURS, "default task, cascade, five samples an action", _BATCH, samples=5),
        Contender(
            "default-map-alignment",
            ours.default_alignment,
            _OURS,
            "the ids' task as it is, five samples an action",
            _BATCH,
            samples=5,
        ),
        Contender("cascade-critical", ours.critical, _OURS, "everything on, cascade-critical", _BATCH),
        Contender("map-alignment", ours.alignment, _OURS, "everything on, map-alignment", (256,)),
        Contender("pictures", ours.pictures, _OURS, "pictures of both cameras, 84 x 84, no estimator", (256,)),
        Contender("sb3", ours.stable_baselines, _OURS, "everything on, Stable-Baselines3 VecEnv", _BATCH),
        Contender("mpe2", peers.mpe2, "mpe2", "MPE2 simple spread, PettingZoo Parallel", _ONE, 1),
        Contender("jaxmarl", peers.jaxmarl_spread, "jaxmarl", "JaxMARL MPE simple spread"),
        Contender("jaxmarl-1", peers.jaxmarl_spread, "jaxmarl", "JaxMARL MPE simple spread", _BATCH, 1),
        Contender("vmas-navigation", peers.vmas_navigation, "vmas", "VMAS navigation"),
        Contender("vmas-navigation-1", peers.vmas_navigation, "vmas", "VMAS navigation", _BATCH, 1),
        Contender("vmas-spread", peers.vmas_spread, "vmas", "VMAS simple spread"),
        Contender("cartpole", peers.cartpole, "gymnasium", "Gymnasium CartPole, vector environment"),
    )
}
"""By name; `-1` is on one core."""
