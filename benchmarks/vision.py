"""Cameras that take pictures beside analytic ones: how good detections are, and what estimators make of them."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from agents.policy import Task
from agents.registry import agent
from benchmarks.vision_trials import trials
from relloc_env.config import EnvConfig, load_config
from relloc_env.envs.onboard import informed
from relloc_env.envs.vector import RellocVectorEnv
from relloc_env.estimators import make, resolve
from relloc_env.files import write_json
from relloc_env.folders import open_folder
from relloc_env.metrics import nees, nees_band, pose_errors
from relloc_env.pinhole import project
from relloc_env.samples import Bool, Float
from relloc_env.scenarios import seeds

FALSE = 5.0
"""[px] a detection farther from its target than this is one of something else."""
SCENARIOS = ("paper-experiment", "open-field")
ESTIMATORS = ("map-alignment", "cascade-critical", "inverse-depth", "cascade")
BLOCK = 10
"""Episodes that are played at once."""
Tell = Callable[[float, str], object]


@dataclass(frozen=True)
class Outcome:
    """What came of some episodes."""

    offset: Float
    """[px] (D, 2) of each detection from where its target is projected, column and row."""
    distance: Float
    """[m] (D,) depth of the target."""
    frames: int
    """Pictures."""
    seen: Bool
    """(...) in the last sample of each action, whether each target was found."""
    visible: Bool
    """(...) and whether an analytic camera would have it in view."""
    poses: dict[str, tuple[Float, Float]]
    """By estimator: [m, m, rad] (N, P, 3) error of each pose at the end, (N, P, 3, 3) its claimed covariance."""

    @property
    def error(self) -> Float:
        """[px] (D,) distance of each detection from where its target is projected."""
        return np.hypot(self.offset[:, 0], self.offset[:, 1])


def play(config: EnvConfig, name: str, chosen: Sequence[int], actions: int | None, tell: Tell) -> Outcome:
    """Play episodes at once, to their end or so many actions; all estimators see the same samples.

    Args:
        config: of the environment.
        name: of the agent.
        chosen: seeds.
        actions: None for all.
        tell: told the part that is done.
    """
    n, rows = len(chosen), np.arange(len(chosen))
    config = config.model_copy(update={"terminate_on_collision": False, "terminate_on_success": False})
    envs = RellocVectorEnv(n, config, estimator=None, autoreset_mode="Disabled", info=())
    simulation, task = envs.core.simulation, Task.of(envs.config)
    policy = agent(name)(task)
    policy.reset(n, 0)
    observations, _ = envs.reset(seed=list(chosen))
    chosen_estimators = {e: make(informed(config, resolve(e)), n, config.robots, config.targets) for e in ESTIMATORS}
    for estimator in chosen_estimators.values():
        estimator.reset(simulation.prior, rows)
        estimator.update(simulation.first, rows)
    length = min(config.max_cycles, actions or config.max_cycles)
    offsets, distances, seen, visible = [], [], [], []
    focal = config.camera_of(0).focal_length
    mounts = [config.camera_of(r).mount_height for r in range(config.robots)]
    for k in range(length):
        tell(k / length, f"{name}, {n} episodes, {config.camera_of(0).kind}")
        observations = envs.step(policy.act(task.rows(observations)).reshape(n, -1))[0]
        for estimator in chosen_estimators.values():
            estimator.update(simulation.samples, rows)
        samples, poses = simulation.samples, simulation.truth.pose
        truth = project(poses, mounts, simulation.world.points[:, None, None])
        offsets.append(focal * (samples.image - truth[..., :2])[samples.seen])
        distances.append(truth[..., 2][samples.seen])
        seen.append(samples.seen[:, -1].copy())
        visible.append(simulation.world.visible.copy())
    return Outcome(
        np.concatenate(offsets),
        np.concatenate(distances),
        length * config.samples_per_action * n * config.robots,
        np.array(seen),
        np.array(visible),
        {
            e: (pose_errors(one.estimate, simulation.world.pose), one.estimate.pose_covariance.copy())
            for e, one in chosen_estimators.items()
        },
    )


def detection_figures(outcome: Outcome) -> dict[str, Any]:
    """How good the detections are."""
    error = outcome.error
    right = outcome.offset[error < FALSE]
    return {
        "frames": outcome.frames,
        "detections": len(error),
        "false": int(np.sum(error >= FALSE)),
        "median_px": float(np.median(error)),
        "error_95_px": float(np.quantile(error, 0.95)),
        "greatest_px": float(error.max()),
        "mean_px": right.mean(axis=0).tolist(),
        "sd_px": right.std(axis=0).tolist(),
        "found_of_visible": float(outcome.seen[outcome.visible].mean()),
        "by_distance": _by_distance(outcome),
    }


def _by_distance(outcome: Outcome) -> dict[str, Any]:
    """Root mean square of a coordinate's error [px] in each two metres of depth."""
    found = {}
    for near in range(0, 12, 2):
        part = (outcome.distance >= near) & (outcome.distance < near + 2) & (outcome.error < FALSE)
        if part.sum() > 10:
            found[f"{near}-{near + 2} m"] = float(np.sqrt(np.mean(outcome.offset[part] ** 2)))
    return found


def pose_figures(outcome: Outcome) -> dict[str, Any]:
    """How good the poses are at the end, by estimator."""
    found = {}
    for name, (error, claimed) in outcome.poses.items():
        position = np.hypot(error[..., 0], error[..., 1])
        squares = nees(error, claimed)
        found[name] = {
            "position_rms_m": float(np.sqrt(np.mean(position**2))),
            "position_median_m": float(np.median(position)),
            "heading_rms_deg": math.degrees(float(np.sqrt(np.mean(error[..., 2] ** 2)))),
            "nees_mean": float(np.mean(squares)),
            "nees_median": float(np.median(squares)),
            "nees_band": list(nees_band(3, len(error))),
        }
    return found


def run(
    out: Path, *, episodes: int = 100, repetitions: int = 5, pictures: int = 200, actions: int | None = None,
    name: str = "sinusoid", tell: Tell,
) -> dict[str, Any]:  # fmt: skip
    """Measure, and write `vision.json` into a folder.

    Args:
        out: folder, made where it is missing.
        episodes: of `open-field`, seeds of the test set.
        repetitions: of the paper's experiment, which differ in their noise.
        pictures: of each row of the table of hard cases.
        actions: of each episode; None for all.
        name: of the agent in `open-field`.
        tell: told the part that is done.

    Returns:
        What `vision.json` holds.
    """
    out = open_folder(out)
    noise = load_config(None, camera="image").camera_of(0).image.detection_noise
    results: dict[str, Any] = {
        "settings": {"episodes": episodes, "actions": actions, "agent": name, "noise_px": noise},
        "runs": {},
    }
    jobs = [
        (scenario, kind, motion, count)
        for scenario, motion, count in zip(SCENARIOS, ("paper", name), (repetitions, episodes), strict=True)
        for kind in ("analytic", "image")
    ]
    for k, (scenario, kind, motion, count) in enumerate(jobs):

        def part(done: float, words: str, k: int = k) -> None:
            tell(0.9 * (k + done) / len(jobs), words)

        config = load_config(scenario, camera={"kind": kind, "pixel_noise": noise})
        chosen, outcomes = seeds("test", count), []
        for start in range(0, count, BLOCK):
            some = chosen[start : start + BLOCK]
            tell_part = _within(part, start / count, min(start + BLOCK, count) / count)
            outcomes.append(play(config, motion, some, actions, tell_part))
            outcome = together(outcomes)
            results["runs"][f"{scenario}, {kind}"] = {
                "episodes": start + len(some),
                "detections": detection_figures(outcome),
                "poses": pose_figures(outcome),
            }
            write_json(out / "vision.json", results)
    results["trials"] = trials(pictures, lambda done, words: tell(0.9 + 0.1 * done, words))
    write_json(out / "vision.json", results)
    return results


def _within(tell: Tell, start: float, end: float) -> Tell:
    """Tells of a part from `start` to `end` of a whole."""
    return lambda done, words: tell(start + done * (end - start), words)


def together(outcomes: Sequence[Outcome]) -> Outcome:
    """What came of all of them."""
    return Outcome(
        np.concatenate([one.offset for one in outcomes]),
        np.concatenate([one.distance for one in outcomes]),
        sum(one.frames for one in outcomes),
        np.concatenate([one.seen for one in outcomes], axis=1),
        np.concatenate([one.visible for one in outcomes], axis=1),
        {
            e: (
                np.concatenate([one.poses[e][0] for one in outcomes]),
                np.concatenate([one.poses[e][1] for one in outcomes]),
            )
            for e in outcomes[0].poses
        },
    )


def ratios(results: Mapping[str, Any]) -> dict[str, dict[str, float]]:
    """By scenario and estimator, position error through pictures over that of the analytic camera."""
    found: dict[str, dict[str, float]] = {}
    for scenario in SCENARIOS:
        image, analytic = (results["runs"][f"{scenario}, {kind}"]["poses"] for kind in ("image", "analytic"))
        found[scenario] = {e: image[e]["position_rms_m"] / analytic[e]["position_rms_m"] for e in image}
    return found


def tables(results: Mapping[str, Any]) -> list[Table]:
    """Detections, poses and hard cases, for a terminal; ratios are of rms errors, to the analytic camera's."""
    found = _table("Detections, px", "run", "pictures", "false", "median", "95 %", "greatest", "found")
    bands = (
        "{}: {:.1f} to {:.1f}".format(
            scenario, *results["runs"][f"{scenario}, image"]["poses"][ESTIMATORS[0]]["nees_band"]
        )
        for scenario in SCENARIOS
    )
    poses = _table(
        "Poses at the end, m. 95 % of mean NEES: " + "; ".join(bands),
        "run", "estimator", "rms", "ratio", "median", "NEES",
    )  # fmt: skip
    over = ratios(results)
    for name, row in results["runs"].items():
        scenario, _, kind = name.partition(", ")
        d, run = row["detections"], f"{scenario},\n{kind}"
        found.add_row(
            run, f"{d['frames']:,}", str(d["false"]), f"{d['median_px']:.3f}", f"{d['error_95_px']:.3f}",
            f"{d['greatest_px']:.2f}", f"{d['found_of_visible']:.3f}",
        )  # fmt: skip
        for k, (estimator, p) in enumerate(row["poses"].items()):
            ratio = f"{over[scenario][estimator]:.2f}" if kind == "image" else ""
            poses.add_row(
                run.splitlines()[k] if k < 2 else "", estimator, f"{p['position_rms_m']:.2g}", ratio,
                f"{p['position_median_m']:.2g}", f"{p['nees_mean']:.3g}",
            )  # fmt: skip
    hard = _table("Hard cases, single pictures, px", "case", "found", "median", "95 %", "false")
    for name, t in results["trials"].items():
        pixels = ("–" if t[key] is None else f"{t[key]:.3f}" for key in ("median_px", "error_95_px"))
        hard.add_row(name, f"{t['found']:.3f}", *pixels, f"{t['false']:.3f}")
    return [found, poses, hard]


def _table(title: str, *heads: str) -> Table:
    """Return an empty one, narrow enough for 80 columns; words stand on the left."""
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1))
    for head in heads:
        words = head in ("run", "estimator", "case")
        table.add_column(head, justify="left" if words else "right", no_wrap=words)
    return table
