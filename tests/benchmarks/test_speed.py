"""How the benchmark measures; how fast anything is, is not tested."""

import importlib.util
import json
import time

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks import ours, peers, speed, targets
from benchmarks.__main__ import app
from benchmarks.contenders import BATCH, CONTENDERS, Contender
from benchmarks.worker import Worker, array_bytes


def worker(drive):
    """A worker in this process, with a drive of one environment."""
    made = Worker("cartpole")
    made._drives[1] = drive
    return made


def entry(name, num_envs, rates):
    return {"name": name, "num_envs": num_envs, "rates": {str(r): rate for r, rate in enumerate(rates)}}


def test_worker_counts_what_the_drive_says_over_the_time_that_it_took():
    def drive():
        time.sleep(0.002)
        return 7

    answer = worker(drive).run(1, 0.05)
    assert answer["seconds"] >= 0.05
    assert answer["steps"] % 7 == 0
    assert 1 <= answer["steps"] / 7 <= answer["seconds"] / 0.002


@pytest.mark.parametrize("leak", [0, 1000])
def test_growth_is_what_a_drive_keeps(leak):
    kept = []

    def drive():
        kept.append(bytes(leak)) if leak else None
        return 10

    traced = worker(drive).growth(1, steps=100, traced=1000)["traced"]
    assert abs(traced - 100 * leak) < 5000 + 0.1 * 100 * leak


def test_array_bytes_counts_each_buffer_once():
    class Holder:
        def __init__(self):
            self.whole = np.zeros((10, 100))
            self.views = [self.whole[3], {"again": self.whole.T}]
            self.other = (np.zeros(7, np.float32),)
            self.itself = self

    assert array_bytes(Holder()) == 8000 + 28


def test_ratio_is_taken_round_by_round_against_the_faster_peer():
    entries = [
        entry("fast", 1, [10.0, 40.0, 90.0]),
        entry("fast", 2, [1.0, 1.0, 1.0]),
        entry("slow", 1, [5.0, 10.0, 10.0, 7.0]),
        entry("slow-1", 1, [2.0, 20.0, 10.0]),
    ]
    found = speed.ratio(entries, ("fast",), ("slow", "slow-1"), 1)
    assert found is not None
    assert (found["min"], found["median"], found["max"]) == (2.0, 2.0, 9.0)
    assert speed.ratio(entries, ("fast",), ("nobody",), 1) is None


def test_targets_are_reached_missed_or_not_measured():
    results = {
        "contenders": [
            {"name": "everything", "num_envs": BATCH, "rates": {"0": 3.0, "1": 3.2}},
            {"name": "jaxmarl", "num_envs": BATCH, "rates": {"0": 1.0, "1": 1.0}},
            {"name": "vmas-navigation", "num_envs": BATCH, "rates": {"0": 2.0, "1": 2.0}},
            {"name": "pictures", "num_envs": 256, "rates": {"0": 10_100.0, "1": 9_950.0}},
        ],
        "startup": {"import_relloc_env": speed.spread([0.029, 0.031, 0.02])},
        "memory": {"arrays": 5000.0},
    }
    found = {target.words: target for target in targets.targets(results)}
    assert found[f"batch of {BATCH} / JaxMARL MPE"].value == pytest.approx(3.1)
    verdicts = {words: target.reached for words, target in found.items() if target.reached is not None}
    assert verdicts == {
        f"batch of {BATCH} / JaxMARL MPE": True,
        f"batch of {BATCH} / VMAS navigation": False,
        "pictures of 84 x 84": True,
        "import relloc_env, after gymnasium": True,
        "memory of an environment, arrays": False,
    }


def test_actions_are_smooth_within_bounds_and_never_jump():
    player = ours._Player(64)
    played = np.array([player.next() for _ in range(3 * len(player._bank))])
    assert played.shape[1:] == (64, 2 * peers.AGENTS)
    assert np.abs(played).max() == 1.0
    assert np.abs(np.diff(played, axis=0)).max() < 1.0
    inside = played[..., 1] / 0.5  # yaw rates, seldom clipped
    kept = np.mean(inside[1:] * inside[:-1]) / np.mean(inside**2)
    assert kept == pytest.approx(np.exp(-1.0 / ours.STEADY), abs=0.01)


@pytest.mark.filterwarnings("ignore")  # theirs to mend
@pytest.mark.parametrize("contender", [c for c in CONTENDERS.values() if c.package not in ("relloc-env", "gymnasium")])
def test_peers_step(contender):
    if importlib.util.find_spec(contender.package) is None:
        pytest.skip(f"{contender.package} is not installed: extra `peers`")
    assert contender.set_up(1)() == peers.block(1)


@pytest.mark.parametrize("name", ["parallel", "gymnasium"])
def test_doors_of_one_environment_step(name):
    assert CONTENDERS[name].set_up(1)() == peers.block(1)


def test_batch_steps_and_tells_how_often_robots_touch():
    free = {**ours.EVERYTHING, "arena": None, "max_cycles": 40}
    walled = {**free, "arena": (6.0, 6.0), "poses": [(2.8, 0.0, 0.0), (-2.8, 0.0, np.pi)], "start": {"in_view": False}}
    batches = [ours.Batch(options, 8) for options in (free, walled)]
    assert all(batch() > 0 for batch in batches)
    assert batches[0].contact_share() == 0.0
    assert batches[1].contact_share() > 0.5


def test_measure_alternates_and_reports_who_is_not_there(monkeypatch):
    absent = Contender("absent", peers.mpe2, "no-such-distribution", "", (1,))
    monkeypatch.setitem(CONTENDERS, "absent", absent)
    broken = Contender("unknown to workers", peers.mpe2, "gymnasium", "", (1,))
    monkeypatch.setitem(CONTENDERS, broken.name, broken)
    told = []
    found = speed.measure(
        ["absent", "cartpole", broken.name],
        sizes=(1, 4), rounds=4, seconds=0.001, warm_up=0.0, tell=lambda part, _: told.append(part),
    )  # fmt: skip
    by_name = {(e["name"], e["num_envs"]): e for e in found}
    assert by_name["absent", 1]["status"] == "not installed"
    assert by_name["absent", 1]["steps_per_second"] is None
    assert by_name[broken.name, 1]["status"].startswith("failed: KeyError")
    assert list(by_name["cartpole", 1]["rates"]) == ["0", "1", "2", "3"]
    assert list(by_name["cartpole", 4]["rates"]) == ["0", "3"]  # every third round: for the plot alone
    assert all(rate > 0 for rate in by_name["cartpole", 4]["rates"].values())
    assert told == sorted(told)
    assert 0.0 <= told[0] <= told[-1] < 1.0


def test_command_writes_data_and_plot(tmp_path):
    done = CliRunner().invoke(app, ["speed", "--quick", "--only", "cartpole", "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    results = json.loads((tmp_path / "results.json").read_text("utf-8"))
    assert [e["num_envs"] for e in results["contenders"]] == [1, 4]
    assert results["machine"]["versions"]["numpy"] == np.__version__
    assert {t["reached"] for t in results["targets"]} == {None}
    assert (tmp_path / "speed.png").stat().st_size > 1000
    assert "CartPole" in done.output


def test_command_refuses_unknown_contenders(tmp_path):
    done = CliRunner().invoke(app, ["speed", "--only", "nobody", "--out", str(tmp_path / "out")])
    assert done.exit_code == 2
    assert "must be among" in done.output
    assert not (tmp_path / "out").exists()
