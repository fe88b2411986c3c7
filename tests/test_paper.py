"""The paper's reproduction: its runs against independent integration and published times, its claims, its figures."""

import io
import json
import math
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from scipy.integrate import solve_ivp

from relloc_env.config import load_config
from relloc_env.kernels.motion import advance
from relloc_env.paper import reproduce
from relloc_env.paper.claim import Verdict, claim, claims_markdown, claims_table, write_claims
from relloc_env.paper.claims_relative_pose import least_information
from relloc_env.paper.figures import FORMATS
from relloc_env.paper.geometries import places_in_view, settle, study_geometries
from relloc_env.paper.runs import DURATION, EXPERIMENT, PAPER_GAINS, settle_time
from relloc_env.paper.studies import (
    Studies,
    gain_name,
    narrowest_view,
    run_studies,
    settle_times,
)

ROOT = Path(__file__).resolve().parents[1]
PAPER = gain_name(PAPER_GAINS)
KEYS = {"id", "quote", "source", "measured", "verdict", "note"}
# Whatever the open parameters are: misprints and statements that cannot hold (docs/equations.md, sections 3, 4 and 6),
# equations that are right, what was chosen so that it comes out, and what depends on a noise that is not given.
VERDICTS = {
    Verdict.FAILS: {
        "observer",
        "robot-motion",
        "point-in-both-frames",
        "observation-model",
        "filter-prediction",
        "filter-update",
        "gains",
        "two-robot-translation",
        "two-robot-heading",
    },
    Verdict.HOLDS: {
        "point-dynamics",
        "image-dynamics",
        "vehicle-dynamics",
        "excitation-norm",
        "persistent-excitation",
        "centre-hides-depth",
        "relative-dynamics",
        "two-correspondences",
        "four-points-converge",
    },
    Verdict.CONSISTENT: {"targets-in-view", "depth-times"},
    Verdict.UNDETERMINED: {"pose-with-noise", "more-points"},
}


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """All of it, once: (folder, claims, studies)."""
    out, said = tmp_path_factory.mktemp("paper") / "new", list[str]()
    studies = run_studies(said.append)
    assert said
    return out, reproduce(out, studies=studies), studies


@pytest.fixture(scope="module")
def studies(result) -> Studies:
    return result[2]


def by_id(result):
    return {one.id: one for one in result[1]}


def experiment_setup():
    config = load_config("paper-experiment")
    return config.poses, config.points, config.camera_of(0), config.robot_of(0)


# --- integration on our own: closed-form motion, SciPy for the observer ---


def target_in_camera(pose, velocity, target, time):
    """(ahead, left) of a world point for a robot on an arc; a point in the plane is a complex number."""
    x, y, angle = pose
    v, w = velocity
    travelled = v * time if w == 0.0 else v * (np.exp(1j * w * time) - 1.0) / (1j * w)
    robot = complex(x, y) + np.exp(1j * angle) * travelled
    seen = (target[0] + 1j * target[1] - robot) * np.exp(-1j * (angle + w * time))
    return seen.real, seen.imag


def observer_depth_error(pose, velocity, target, height, guess, gains=PAPER_GAINS, end=DURATION):
    """Depth error on a grid of 1 ms, by DOP853."""
    v, w = velocity
    h, alpha_lambda = gains

    def image(t):
        ahead, left = target_in_camera(pose, velocity, target, t)
        return -left / ahead, -height / ahead

    def rate(t, state):
        x, y = image(t)
        xh, yh, chi = state
        return [
            w * (1.0 + x * x) + v * x * chi + h * (x - xh),
            w * x * y + v * y * chi + h * (y - yh),
            v * chi * chi + w * x * chi + alpha_lambda * v * (x * (x - xh) + y * (y - yh)),
        ]

    ahead = target_in_camera(pose, velocity, target, 0.0)[0]
    grid = np.arange(0.0, end + 5e-4, 1e-3)
    start = [*image(0.0), 1.0 / (ahead + guess)]
    solution = solve_ivp(rate, (0.0, end), start, method="DOP853", rtol=1e-9, atol=1e-12, t_eval=grid)
    return grid, 1.0 / solution.y[2] - target_in_camera(pose, velocity, target, grid)[0]


def last_time_above(grid, error, limit=0.1):
    above = np.flatnonzero(np.abs(error) >= limit)
    return math.inf if above[-1] == len(grid) - 1 else grid[above[-1]]


# --- the four points ---


def test_four_points_settle_at_the_published_times(studies):
    # docs/equations.md, section 3: times to ± 0.05 s
    assert settle_times(studies.four, PAPER) == pytest.approx([math.inf, 3.75, 3.75, 1.85], abs=0.05)
    assert settle_times(studies.four_near, PAPER) == pytest.approx([math.inf, 4.2, 4.2, 2.0], abs=0.05)


@pytest.mark.parametrize(
    ("gains", "time"),
    [
        ((1.0, 120.0), 4.05),
        ((5.0, 120.0), 7.4),
        ((10.0, 120.0), 13.05),
        ((2.5, 30.0), 12.9),
        ((2.5, 60.0), 7.25),
        ((2.5, 240.0), 1.85),
        ((2.5, 480.0), 1.05),
    ],
)
def test_p3_settles_at_the_published_times(studies, gains, time):
    assert settle_times(studies.four, gain_name(gains))[2] == pytest.approx(time, abs=0.05)


@pytest.mark.parametrize("point", [(0.0, -5.0), (-5.0, 0.0), (-5.0, -5.0)], ids=["p2", "p3", "p4"])
def test_four_points_follow_the_continuous_observer(studies, point):
    left, height = point
    index = {(0.0, -5.0): 1, (-5.0, 0.0): 2, (-5.0, -5.0): 3}[point]
    _, exact = observer_depth_error((0.0, 0.0, 0.0), (0.1, 0.0), (5.0, left), height, 1.0)
    ours = studies.four.tracks[PAPER].depth[0, :, 0, index]
    assert np.abs(ours - exact[::50]).max() < 0.005


def test_p1_keeps_its_error(studies):
    assert np.abs(studies.four.tracks[PAPER].depth[:, :, 0, 0] - 1.0).max() < 1e-6


# --- the experiment ---


def test_experiment_starts_with_the_papers_errors(studies):
    config = load_config("paper-experiment")
    assert EXPERIMENT == ((0.1, 0.02), (0.1, -0.03))
    assert (config.guess.depth, config.guess.position, config.guess.heading) == (1.0, 1.5, 60.0)
    assert studies.experiment.time[-1] == pytest.approx(40.0)
    first = studies.experiment.tracks["printed"]
    assert first.depth[0, 0] == pytest.approx(np.ones((2, 2)))


def test_experiment_keeps_both_targets_in_view():
    poses, points, camera, _ = experiment_setup()
    grid = np.arange(0.0, 40.0005, 1e-3)
    for pose, velocity in zip(poses, EXPERIMENT, strict=True):
        for x, y, z in points:
            ahead, left = target_in_camera(pose, velocity, (x, y), grid)
            assert ahead.min() > camera.near
            assert np.abs(left / ahead).max() < 0.5 * camera.width / camera.focal_length
            assert np.abs((z - camera.mount_height) / ahead).max() < 0.5 * camera.height / camera.focal_length


def test_experiment_keeps_robots_and_lines_of_sight_clear():
    poses, points, _, body = experiment_setup()
    grid = np.arange(0.0, 40.005, 1e-2)
    paths = []
    for (x, y, angle), (v, w) in zip(poses, EXPERIMENT, strict=True):
        paths.append(complex(x, y) + np.exp(1j * angle) * v * (np.exp(1j * w * grid) - 1.0) / (1j * w))
    assert np.abs(paths[0] - paths[1]).min() > 2.0 * body.radius
    for own, other in (paths, paths[::-1]):
        for x, y, _ in points:
            line = complex(x, y) - own
            share = np.clip(((other - own) * line.conj()).real / np.abs(line) ** 2, 0.0, 1.0)
            assert np.abs(own + share * line - other).min() > body.radius


@pytest.mark.parametrize(("robot", "paper"), [(0, 13.0), (1, 25.0)], ids="AB")
def test_experiment_depths_converge_at_the_papers_times(result, robot, paper):
    poses, points, camera, _ = experiment_setup()
    measured = by_id(result)["depth-times"].measured
    for i, (x, y, z) in enumerate(points):
        height = z - camera.mount_height
        grid, error = observer_depth_error(poses[robot], EXPERIMENT[robot], (x, y), height, 1.0)
        time = last_time_above(grid, error)
        assert time == pytest.approx(paper, abs=1.5)
        assert measured[f"{'AB'[robot]}, target {i + 1} [s]"] == pytest.approx(time, abs=0.05)
        # no accident of the limit: 20 % to either side move it by 6 s at most
        assert last_time_above(grid, error, 0.12) > time - 6.0
        assert last_time_above(grid, error, 0.08) < time + 6.0


def test_no_place_stays_in_robot_b_narrow_view():
    # B turns by 1.2 rad: a direction far away needs half of it, and a place at a finite distance no less here
    assert math.degrees(0.6) - 1e-6 < narrowest_view(-0.03, 2000) < 36.0
    assert narrowest_view(-0.03, 2000) > narrowest_view(0.02, 2000)


def test_experiment_pose_converges_with_position_and_not_as_printed(studies):
    run = studies.experiment
    assert run.tracks["position"].position[0, -1].max() < 0.05
    assert run.tracks["position"].heading[0, -1].max() < 0.5
    assert run.tracks["printed"].position[0, -1].min() > 1.0
    # r does not enter the printed model: its variance can only grow
    spread = run.tracks["printed"].pose_covariance[0, :, 0, 0, 0] + run.tracks["printed"].pose_covariance[0, :, 0, 1, 1]
    assert spread[-1] >= spread[0]


def test_information_of_the_models_is_as_published():
    # docs/equations.md, section 4: 0 / 0.00105 / 2.62
    poses = [[np.array([0.0, 0.0, 0.0]), np.array([0.0, -1.5, math.radians(30.0)])]]
    for _ in range(800):
        poses.append([np.array(advance(*p, v, 0.0, w, 0.05)) for p, (v, w) in zip(poses[-1], EXPERIMENT, strict=True)])
    robots, targets = np.array(poses), np.array([[4.0, 0.6], [4.5, -1.0]])
    found = [least_information(robots, targets, 0.05, model) for model in ("printed", "velocity", "position")]
    assert found == pytest.approx([0.0, 0.00105, 2.62], rel=0.01, abs=1e-12)


# --- two robots in simulation ---


def test_two_robot_simulation_cannot_place_p1(studies):
    run = studies.simulation
    assert run.seen.all()
    track = run.tracks["position"]
    assert np.abs(track.depth[0, :, 0, 0] - 1.0).max() < 1e-6
    assert track.position[0, -1].min() > 0.1
    assert studies.simulation_off_axis.tracks["position"].position[0, -1].max() < 0.001


def test_straight_ahead_printed_model_drives_the_heading_to_zero_and_velocity_learns_nothing(studies):
    run = studies.simulation
    truth = math.degrees(run.robots[0, -1, 1, 2] - run.robots[0, -1, 0, 2])
    estimate = truth + np.degrees(run.tracks["printed"].pose[0, -1, 0, 2])
    assert estimate == pytest.approx(0.0, abs=0.1)
    assert np.degrees(run.tracks["velocity"].pose[0, :, :, 2]) == pytest.approx(15.0, abs=1e-6)


# --- claims and figures ---


def test_claims_file_is_complete_and_valid(result):
    out, claims, _ = result
    written = json.loads((out / "claims.json").read_text(encoding="utf-8"))
    assert [one["id"] for one in written] == [one.id for one in claims]
    assert len({one["id"] for one in written}) == len(written)
    for one in written:
        assert set(one) == KEYS
        assert all(isinstance(one[key], str) for key in KEYS - {"measured"})
        assert all(one[key] for key in ("id", "quote", "source"))
        assert one["source"].startswith(("III", "IV"))
        assert one["verdict"] in list(Verdict)
        assert one["measured"]
        for value in one["measured"].values():
            assert value is None or math.isfinite(value)
        assert one["verdict"] == Verdict.HOLDS or one["note"], f"{one['id']} does not hold and says not why"


def test_each_claim_is_one_printed_sentence(result):
    quotes = [one.quote for one in result[1]]
    assert len(set(quotes)) == len(quotes)
    for quote in quotes:
        # A full stop ends the quote and stands nowhere else, but in "i.e." and "Fig.".
        assert quote.endswith(".")
        assert not re.search(r"(?<!i\.e)(?<!Fig)\. ", quote), quote


def test_claims_hold_where_they_can_and_not_where_they_cannot(result):
    claims = by_id(result)
    found = {
        verdict: {name for name in names if claims[name].verdict == verdict} for verdict, names in VERDICTS.items()
    }
    assert found == VERDICTS


def test_what_depends_on_the_assumed_noise_shows_both_figures(result):
    claims = by_id(result)
    pose, points = claims["pose-with-noise"].measured, claims["more-points"].measured
    assert (
        pose["noise of image: A→B after 40 s, RMS [m]"]
        < 0.05
        < pose["noise of image and odometry: A→B after 40 s, RMS [m]"]
    )
    for noise, helps in (("image alone", True), ("odometry too", False)):
        two, six, lost = (
            points[f"noise of the {noise}: {what} [m]"] for what in ("2 points", "6 points", "6 points, one lost")
        )
        assert (max(six, lost) < 0.9 * two) == helps


def test_verdict_is_undetermined_where_the_cases_differ():
    assert [Verdict.of(*cases) for cases in ((True,), (True, True), (False, False), (True, False))] == [
        Verdict.HOLDS,
        Verdict.HOLDS,
        Verdict.FAILS,
        Verdict.UNDETERMINED,
    ]


NUMBER = re.compile(r"-?\d[\d,]*\.?\d*(?:e-?\d+)?")


def test_docs_show_the_claims_as_they_were_found(result):
    """docs/paper.md has claims.md of the command; the last digit may differ from machine to machine."""
    found = claims_markdown(result[1])
    page = (ROOT / "docs" / "paper.md").read_text(encoding="utf-8")
    shown = page.split("<!-- claims.md -->\n")[1]
    assert NUMBER.sub("#", shown) == NUMBER.sub("#", found), "put out/paper/claims.md there anew"
    numbers = [[float(one.replace(",", "")) for one in NUMBER.findall(text)] for text in (shown, found)]
    assert numbers[0] == pytest.approx(numbers[1], rel=0.02, abs=1e-5)


# --- random geometries ---


def test_geometries_settle_as_the_simulated_experiment_does(result):
    poses, points, camera, _ = experiment_setup()
    measured = by_id(result)["depth-times"].measured
    for robot, name in enumerate("AB"):
        seen = [target_in_camera(poses[robot], EXPERIMENT[robot], (x, y), 0.0) for x, y, _ in points]
        places = (*np.transpose(seen), np.array([z - camera.mount_height for *_, z in points]))
        for guess, words in ((1.0, ""), (-1.0, ", guess too near")):
            times = [measured[f"{name}, target {i}{words} [s]"] for i in (1, 2)]
            assert settle(places, EXPERIMENT[robot], guess) == pytest.approx(times, abs=0.1)


def test_geometries_keep_targets_in_view(result):
    """Of 400 geometries, by closed-form motion at other instants than those that chose them."""
    *_, camera, _ = experiment_setup()
    found = places_in_view(400, seed=3)
    assert found.shape == (2, 3, 400, 2)
    for places, velocity in zip(found, EXPERIMENT, strict=True):
        for time in np.linspace(0.0, 40.0, 54):
            ahead, left = target_in_camera((0.0, 0.0, 0.0), velocity, (places[0], places[1]), time)
            assert np.abs(left / ahead).max() < 0.5 * camera.width / camera.focal_length + 1e-3
            assert np.abs(places[2] / ahead).max() < 0.5 * camera.height / camera.focal_length + 1e-3
            assert ahead.min() > camera.near
    apart = np.hypot(*(found[0, :2, :, 0] - found[0, :2, :, 1])) - np.hypot(*(found[1, :2, :, 0] - found[1, :2, :, 1]))
    assert np.abs(apart).max() < 1e-9


def test_hardly_any_geometry_gives_the_papers_times(result):
    study = result[2].geometries
    assert study.count == 20_000
    assert study.number(0) <= 5
    assert 0.0005 < study.share(0, later=True) < 0.005
    assert study_geometries(100, seed=5).times == pytest.approx(study_geometries(100, seed=5).times)


def test_table_shows_every_claim(result):
    stream = io.StringIO()
    Console(width=120, file=stream).print(claims_table(result[1]))
    text = stream.getvalue()
    assert all(one.id in text for one in result[1])


def test_figures_are_there(result):
    out = result[0]
    names = {path.stem for path in out.iterdir()} - {"claims"}
    assert len(names) == 5
    for name in names:
        for suffix in FORMATS:
            data = (out / f"{name}.{suffix}").read_bytes()
            if suffix == "png":
                assert data.startswith(b"\x89PNG")
                width, height = (int.from_bytes(data[k : k + 4], "big") for k in (16, 20))
                assert min(width, height) > 500
            else:
                assert ET.fromstring(data).tag.endswith("svg")


# --- small parts ---


def test_settle_time_is_that_of_an_exponential():
    time = np.arange(0.0, 10.0, 0.05)
    assert settle_time(time, np.exp(-time)) == pytest.approx(math.log(10.0), abs=1e-3)
    assert settle_time(time, -np.exp(-time)) == pytest.approx(math.log(10.0), abs=1e-3)


def test_settle_time_counts_the_last_crossing():
    time = np.arange(5.0)
    assert settle_time(time, np.array([1.0, 0.0, 0.3, 0.0, 0.0])) == pytest.approx(2.0 + 2.0 / 3.0)
    assert settle_time(time, np.array([1.0, 0.0, 0.0, 0.0, 0.3])) == math.inf
    assert settle_time(time, np.array([1.0, 0.0, 0.0, 0.0, math.nan])) == math.inf
    assert settle_time(time, np.zeros(5)) == 0.0


def test_what_never_happens_is_written_as_null(tmp_path):
    one = claim("x", "text", "IV", {"time [s]": math.inf, "error [m]": 0.123456}, Verdict.FAILS, "why")
    write_claims([one], tmp_path)
    assert json.loads((tmp_path / "claims.json").read_text())[0]["measured"] == {"time [s]": None, "error [m]": 0.1235}
