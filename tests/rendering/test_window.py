"""What belongs to the process: pygame's display and fonts, which others start and stop. Each case is a process."""

import pytest

from tests.rendering.test_renderer import fresh

DUMMY = {"SDL_VIDEODRIVER": "dummy", "PYGAME_HIDE_SUPPORT_PROMPT": "1", "RELLOC_QUIET": "1"}
START = """
import gymnasium as gym, numpy as np, pygame, relloc_env
import warnings
from relloc_env.envs.centralised import RellocEnv

def make(robots, mode, **more):
    env = RellocEnv(robots=robots, estimator="cascade", render_mode=mode, max_cycles=4, **more)
    env.reset(seed=1)
    env.step(np.ones(2 * robots))
    return env

def cart_pole(mode):
    other = gym.make("CartPole-v1", render_mode=mode)
    other.reset(seed=0)
    other.render()
    return other

def open_now(env):
    window = env._picture._renderer._window
    return window is not None and not window.closed
"""
STOPS = {
    "another environment closes its window": 'other = cart_pole("human"); STEP; other.close()',
    "another environment that draws into memory closes": 'other = cart_pole("rgb_array"); STEP; other.close()',
    "pygame is stopped": "STEP; pygame.quit()",
    "the display is stopped": "STEP; pygame.display.quit()",
    "pygame is stopped and started": "STEP; pygame.quit(); pygame.init()",
    "fonts are stopped and started": "STEP; pygame.font.quit(); pygame.font.init()",
    "another environment draws after a stop": 'STEP; pygame.quit(); other = cart_pole("human")',
}
"""What others do in the process while an episode of ours is on, by what to call it."""


@pytest.mark.parametrize("mode", ["human", "second window", "rgb_array"])
def test_episodes_outlive_what_others_do_with_pygame(mode: str) -> None:
    """The observations are those of an episode without pictures, pictures in memory those of one left alone."""
    code = (
        START
        + f"""
mode, second = {mode!r}, {mode == "second window"}
mode = "human" if second else mode
def steps():
    shown = [env.step(np.array([0.5, 0.1, 0.4, -0.1]))[0] for env in (ours, alone, still)]
    assert all((one == shown[0]).all() for one in shown)
for name, stop in {STOPS!r}.items():
    first = make(1, "human") if second else None
    ours, alone, still = (make(2, each) for each in (mode, None, "rgb_array"))
    ours.render()
    exec(stop.replace("STEP", "steps()"))
    for _ in range(2):
        if mode == "rgb_array":
            assert (ours.render() == still.render()).all()
        steps() if ours._running else None
    for env in (ours, alone, still):
        env.reset(seed=2)
    steps()
    assert mode == "rgb_array" or open_now(ours)
    for env in (ours, ours, first or ours):
        env.close()
    print(name)
"""
    )
    assert fresh(code, **DUMMY).splitlines() == list(STOPS)


def test_each_environment_has_a_window_of_its_own() -> None:
    printed = fresh(
        START
        + """
a, b = make(2, "human"), make(1, "human")
one, two = (env._picture._renderer._window for env in (a, b))
still = make(2, "rgb_array")
print(one._surface is not two._surface, end=" ")
picture = pygame.surfarray.array3d(one._surface).swapaxes(0, 1)
print((picture == still.render()).all(), end=" ")
b.close()
a.step(np.zeros(4)); print(open_now(a), end=" ")
b.reset(seed=2); b.step(np.zeros(2)); print(open_now(a), open_now(b), end=" ")
a.close()  # pygame's display, with which SDL closes all windows
b.step(np.zeros(2)); print(open_now(b), end=" ")
a.reset(seed=2); a.step(np.zeros(4)); b.step(np.zeros(2)); print(open_now(a), open_now(b), end=" ")
a.close(); b.close(); print(pygame.display.get_init())
""",
        **DUMMY,
    )
    assert printed == "True True True True True True True True False"


@pytest.mark.parametrize(
    ("event", "left"),
    [
        ("pygame.QUIT", (False, False)),
        ("pygame.WINDOWCLOSE, window=two.own", (True, False)),
        ("pygame.KEYDOWN, key=pygame.K_ESCAPE, window=two.own", (True, False)),
        ("pygame.WINDOWCLOSE, window='the display'", (False, True)),
        ("pygame.KEYDOWN, key=pygame.K_a", (True, True)),
    ],
)
def test_users_close_the_window_that_they_mean(event: str, left: tuple[bool, bool]) -> None:
    """It stays closed in the next episode, and its environment goes on."""
    printed = fresh(
        START
        + f"""
a, b = make(2, "human"), make(1, "human")
one, two = (env._picture._renderer._window for env in (a, b))
pygame.event.post(pygame.event.Event({event}))
for _ in range(3):
    a.step(np.zeros(4)); b.step(np.zeros(2))
print(open_now(a), open_now(b), end=" ")
a.reset(); b.reset()
print(open_now(a), open_now(b))
""",
        **DUMMY,
    )
    assert printed == "{0} {1} {0} {1}".format(*left)


@pytest.mark.parametrize("driver", [None, "none-such", "dummy", "offscreen"])
def test_without_a_display_is_said_unless_it_was_chosen(driver: str | None) -> None:
    """With `render_mode="human"` and in `play`. SDL itself falls back on a driver that shows nothing."""
    code = (
        START
        + """
from relloc_env.play import Session, play
def use(call):
    try:
        call()
    except (OSError, RuntimeError) as error:
        print("no display" if "display" in str(error) else error, end=" ")
    else:
        print("goes on", end=" ")
use(lambda: make(2, "human"))
def drive():
    def close(scene):
        pygame.event.post(pygame.event.Event(pygame.QUIT))
    play(Session(estimator="cascade"), size=(480, 270), watch=close)
use(drive)
print(pygame.display.get_init())
"""
    )
    environment = {"PYGAME_HIDE_SUPPORT_PROMPT": "1", "RELLOC_QUIET": "1"}
    environment |= {} if driver is None else {"SDL_VIDEODRIVER": driver}
    chosen = driver in {"dummy", "offscreen"}
    assert fresh(code, **environment) == ("goes on goes on False" if chosen else "no display no display False")


def test_a_drive_ends_where_somebody_stops_its_display() -> None:
    printed = fresh(
        START
        + """
import tempfile
from relloc_env.play import Session, play
with tempfile.TemporaryDirectory() as folder:
    session = Session(estimator="cascade", logs=folder)
    play(session, size=(480, 270), watch=lambda scene: pygame.quit() if scene.time > 0.2 else None)
    print(len(session.written), (session.written[0] / "log.json").is_file())
""",
        **DUMMY,
    )
    assert printed == "1 True"
