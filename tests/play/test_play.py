"""A short drive by events, without a display: what is driven, switched, recorded, and replayed."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from relloc_env.logs import read_log
from relloc_env.play import Session, play
from relloc_env.play.window import Window
from relloc_env.replay import replay
from relloc_env.vision.sensor import Sensor

pygame = pytest.importorskip("pygame")


@pytest.fixture
def window(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Window]:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    session = Session(estimator="cascade", seed=4, logs=tmp_path / "drives", arena=None, shield=None)
    window = Window(session, (480, 270))
    yield window
    window.close()


def press(*keys: int, down: bool = True) -> None:
    for key in keys:
        pygame.event.post(pygame.event.Event(pygame.KEYDOWN if down else pygame.KEYUP, key=key))


def ticks(window: Window, count: int) -> None:
    for _ in range(count):
        window.tick()


def test_keys_drive_and_the_drive_is_replayed(window: Window, tmp_path: Path) -> None:
    session = window._session
    poses = session.core.simulation.world.pose[0]
    start = poses.copy()
    press(pygame.K_w, pygame.K_LEFT)
    ticks(window, 20)
    moved = poses - start
    limits = session.config.robot_of(0)
    assert np.hypot(*moved[0, :2]) == pytest.approx(limits.max_speed, rel=1e-6)  # A goes ahead for a second,
    assert moved[0, 2] == pytest.approx(0.0, abs=1e-9)
    assert np.hypot(*moved[1, :2]) == pytest.approx(0.0, abs=1e-9)  # B turns to the left
    assert np.angle(np.exp(1j * moved[1, 2])) == pytest.approx(limits.max_yaw_rate, rel=1e-6)
    press(pygame.K_LEFT, down=False)
    press(pygame.K_a)
    ticks(window, 40)
    press(pygame.K_n)
    ticks(window, 1)
    assert session.seed == 5
    (path,) = session.written
    log = read_log(path)
    assert len(log) == 61
    assert log.truth is not None
    assert log.truth.poses[0] == pytest.approx(start)
    result = replay(path, estimator="cascade", out=tmp_path / "replay")
    (run,) = result.runs["cascade"]
    assert run.trace.pose.shape == (61, 2, 3)
    assert (tmp_path / "replay" / "replay.json").is_file()


def test_slow_pictures_do_not_slow_the_robots(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures that take 120 ms each, then one of a minute: time keeps its rate, but for the rest of the minute."""

    class Clock:
        lasting = iter([50, *[120] * 10, 60_000])

        def tick(self, rate: float) -> int:
            assert rate == 20.0
            took = next(self.lasting, None)
            if took is None:
                pygame.event.post(pygame.event.Event(pygame.QUIT))
            return took or 0

    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setattr("pygame.time.Clock", Clock)
    session, seen = Session(estimator="cascade", seed=4, arena=None, shield=None), list[float]()
    play(session, size=(480, 270), watch=lambda scene: seen.append(scene.time))
    assert len(seen) == round((0.05 + 1.2) / 0.05) + 10
    assert seen == pytest.approx(0.05 * np.arange(1, len(seen) + 1))


def test_a_replay_believes_what_the_driver_saw(window: Window) -> None:
    session = window._session
    press(pygame.K_w, pygame.K_a, pygame.K_UP, pygame.K_RIGHT)
    ticks(window, 30)
    seen = session.core.onboard.estimate.pose[0].copy()
    session.finish()
    run = replay(session.written[0], estimator="cascade").runs["cascade"][0]
    assert run.trace.pose[-1] == pytest.approx(seen, abs=1e-9)


def test_another_estimator_watches_the_same_drive(window: Window) -> None:
    session = window._session
    press(pygame.K_w, pygame.K_d, pygame.K_DOWN)
    ticks(window, 15)
    before = session.core.simulation.world.pose[0].copy()
    strips = {strip.label: strip for strip in session.scene().strips}
    press(pygame.K_SPACE, pygame.K_e)
    ticks(window, 3)
    assert session.estimator == "cascade-critical"
    assert session.core.simulation.world.pose[0] == pytest.approx(before, abs=0.0)
    again = {strip.label: strip for strip in session.scene().strips}
    assert again["excitation [m/s]"].lines == pytest.approx(strips["excitation [m/s]"].lines, nan_ok=True)
    assert (again["depth error [m]"].lines[:, -1] != strips["depth error [m]"].lines[:, -1]).all()
    press(pygame.K_SPACE)
    ticks(window, 2)
    session.finish()
    assert len(read_log(session.written[0])) == 18  # the first sample, fifteen before the pause, two after it


def test_gains_turn_while_driving(window: Window) -> None:
    session = window._session
    assert session.gains is not None
    h, alpha = session.gains[0, 0]
    press(pygame.K_RIGHTBRACKET, pygame.K_RIGHTBRACKET, pygame.K_MINUS)
    ticks(window, 1)
    assert session.gains == pytest.approx(np.tile([h * 1.25**2, alpha / 1.25], (2, 2, 1)))
    words = dict(window._notes())["cascade"]
    assert words == "H 3.91 1/s, αΛ 96 1/m²"


def test_reset_pause_theme_help_and_end(window: Window) -> None:
    session = window._session
    start = session.core.simulation.world.pose[0].copy()
    press(pygame.K_w)
    ticks(window, 5)
    press(pygame.K_SPACE)
    ticks(window, 1)
    held = session.core.simulation.world.pose[0].copy()
    ticks(window, 3)
    assert (session.core.simulation.world.pose[0] == held).all()
    press(pygame.K_r)
    ticks(window, 1)
    assert session.core.simulation.world.pose[0] == pytest.approx(start, abs=0.0)
    light = pygame.surfarray.array3d(pygame.display.get_surface()).mean()
    press(pygame.K_t, pygame.K_h)
    ticks(window, 1)
    assert pygame.surfarray.array3d(pygame.display.get_surface()).mean() < 0.5 * light
    press(pygame.K_ESCAPE)
    ticks(window, 1)
    assert window.closed


def test_sticks_of_a_gamepad_drive(window: Window) -> None:
    for axis, value in ((1, -1.0), (0, 0.05), (2, 1.0)):
        pygame.event.post(pygame.event.Event(pygame.JOYAXISMOTION, instance_id=0, axis=axis, value=value))
    ticks(window, 1)
    assert window._sticks.action() == pytest.approx(np.array([[1.0, 0.0], [0.0, -1.0]]))


def test_without_a_display_an_error_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    pygame.display.quit()
    monkeypatch.setenv("SDL_VIDEODRIVER", "none-such")
    with pytest.raises(OSError, match="There is no display to open a window on"):
        Window(Session(estimator="cascade"), (480, 270))


def test_a_switch_takes_no_picture_anew_and_changes_nothing_that_follows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Against a drive with the second estimator from the start, to the bit."""
    pytest.importorskip("cv2")
    world: dict[str, Any] = {"camera": {"kind": "image", "width": 320, "height": 240}, "seed": 4, "shield": None}
    switched, straight = Session(estimator="map-alignment", **world), Session(estimator="cascade", **world)
    way = [np.array([[0.6, 0.3 * math.sin(0.4 * k)], [0.5, -0.2]]) for k in range(30)]
    for action in way[:20]:
        switched.step(action)
    taken: list[int] = []
    take = Sensor.take

    def count(*words: Any) -> None:
        taken.append(1)
        take(*words)

    monkeypatch.setattr(Sensor, "take", count)
    switched.next_estimator()
    assert switched.estimator == "cascade"
    assert not taken
    for action in way[20:]:
        switched.step(action)
    assert len(taken) == 20
    for action in way:
        straight.step(action)
    one, other = (session.core for session in (switched, straight))
    for part, wanted in zip(one.onboard.estimate, other.onboard.estimate, strict=True):
        assert np.array_equal(part, wanted)
    assert np.array_equal(one.simulation.samples.image, other.simulation.samples.image)
    assert np.abs(one.onboard.estimate.pose[0, 0] - one.simulation.prior.pose[0, 0]).max() > 0.01
