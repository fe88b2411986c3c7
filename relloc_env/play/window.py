"""The window: keys and sticks in, pictures out."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Literal

from relloc_env.extras import extra
from relloc_env.play.session import Session
from relloc_env.play.sticks import Sticks
from relloc_env.rendering.renderer import SMALLEST, Renderer
from relloc_env.rendering.window import NoDisplayError, start_display

HELP = (
    ("W A S D", "drive robot A; with shift slowly"),
    ("arrows", "drive robot B (one robot: as W A S D)"),
    ("gamepad", "left stick: A, right stick: B"),
    ("space", "pause, go on"),
    ("R", "the same start again"),
    ("N", "another start"),
    ("E", "another estimator, on the same drive"),
    ("[  ]", "cascade: gain H down, up"),
    ("-  =", "cascade: gain αΛ down, up"),
    ("T", "light, dark"),
    ("H", "this help"),
    ("Esc", "end"),
)
"""Keys and what they do."""
MOST = 10
"""Samples that are made up for between two pictures; after a longer halt the time is lost."""
_TURN = 1.25
"""What a key press multiplies a gain by."""


class Window:
    """Shows a session and obeys the keyboard and gamepads.

    Args:
        session: what is driven.
        size: [px] width and height.
        theme: `light` or `dark`.

    Raises:
        NoDisplayError: where there is no display.
    """

    def __init__(
        self, session: Session, size: tuple[int, int] = (1280, 720), theme: Literal["light", "dark"] = "light"
    ) -> None:
        try:
            pygame = start_display()
        except NoDisplayError as error:
            raise NoDisplayError(f"There is no display to open a window on: {error}") from error
        self._pygame, self._make, self._least = pygame, Renderer, SMALLEST
        self._session, self._size, self._theme = session, size, theme
        self._renderer = Renderer(size, theme=theme)
        self.paused, self.helping, self.closed = False, True, False
        try:
            self._surface = pygame.display.set_mode(size, pygame.RESIZABLE)
        except pygame.error as error:
            raise NoDisplayError(f"There is no display to open a window on: {error}") from error
        pygame.display.set_caption("relloc_env")
        self._sticks = Sticks(session.config.robots)
        self._commands = self._keys()

    def tick(self, samples: int = 1, watch: Callable[[Any], object] | None = None) -> None:
        """Obey what happened since the last call, drive for so many samples, and show the last.

        A display that somebody else in this process stopped is a closed window.

        Args:
            samples: to drive for, unless paused.
            watch: called with the scene after each.
        """
        try:
            self._tick(samples, watch)
        except self._pygame.error:
            if self._pygame.display.get_surface() is not None:
                raise
            self.closed = True  # somebody else in this process stopped the display

    def _tick(self, samples: int, watch: Callable[[Any], object] | None) -> None:
        pygame = self._pygame
        for event in pygame.event.get():
            self._sticks.take(event)
            if event.type == pygame.QUIT:
                self.closed = True
            elif event.type == pygame.KEYDOWN and event.key in self._commands:
                self._commands[event.key]()
            elif event.type == pygame.JOYBUTTONDOWN and event.button < 4:
                self._commands[(pygame.K_SPACE, pygame.K_r, pygame.K_n, pygame.K_e)[event.button]]()
            elif event.type == pygame.VIDEORESIZE:
                self._size = max(event.w, self._least[0]), max(event.h, self._least[1])
                self._surface = pygame.display.get_surface()
                self._renderer = self._make(self._size, theme=self._theme)
        if self.closed:
            return
        for _ in range(0 if self.paused else samples):
            self._session.step(self._sticks.action())
            if watch is not None:
                watch(self._session.scene())
        picture = self._renderer.draw(replace(self._session.scene(), notes=self._notes()))
        assert picture is not None
        self._surface.blit(pygame.image.frombuffer(picture.tobytes(), self._size, "RGB"), (0, 0))
        pygame.display.flip()

    def close(self) -> None:
        """Let the window go."""
        self.closed = True
        self._pygame.joystick.quit()
        self._pygame.display.quit()

    def _keys(self) -> Mapping[int, Callable[[], object]]:
        pygame, session = self._pygame, self._session
        return {
            pygame.K_ESCAPE: lambda: setattr(self, "closed", True),
            pygame.K_SPACE: lambda: setattr(self, "paused", not self.paused),
            pygame.K_h: lambda: setattr(self, "helping", not self.helping),
            pygame.K_F1: lambda: setattr(self, "helping", not self.helping),
            pygame.K_r: session.reset,
            pygame.K_n: lambda: session.reset(session.seed + 1),
            pygame.K_e: session.next_estimator,
            pygame.K_t: self._turn_theme,
            pygame.K_LEFTBRACKET: lambda: session.scale_gain(0, 1.0 / _TURN),
            pygame.K_RIGHTBRACKET: lambda: session.scale_gain(0, _TURN),
            pygame.K_MINUS: lambda: session.scale_gain(1, 1.0 / _TURN),
            pygame.K_EQUALS: lambda: session.scale_gain(1, _TURN),
        }

    def _turn_theme(self) -> None:
        self._theme = "dark" if self._theme == "light" else "light"
        self._renderer = self._make(self._size, theme=self._theme)

    def _notes(self) -> list[tuple[str, str]]:
        session = self._session
        gains = session.gains
        words = "no gains to turn" if gains is None else "H {:.3g} 1/s, αΛ {:.3g} 1/m²".format(*gains[0, 0])
        notes = [(session.estimator, words), (f"seed {session.seed}", "paused" if self.paused else "")]
        return [*notes, *(HELP if self.helping else (("H", "help"),))]


def play(
    session: Session,
    *,
    size: tuple[int, int] = (1280, 720),
    theme: Literal["light", "dark"] = "light",
    watch: Callable[[Any], object] | None = None,
) -> None:
    """Open a window on a session until it is closed, in real time; then finish the session.

    Where drawing takes longer than a sample, the robots keep their speed, and not every sample is shown.

    Args:
        session: what is driven.
        size: [px] of the window.
        theme: of the pictures.
        watch: called with the scene after every sample.

    Raises:
        NoDisplayError: where there is no display.
    """
    window = Window(session, size, theme)
    with extra("render"):
        import pygame

    clock, rate, behind = pygame.time.Clock(), session.config.sample_rate, 0.0
    try:
        while not window.closed:
            behind = min(behind + 1e-3 * clock.tick(rate) * rate, MOST)
            samples = round(behind)
            window.tick(samples, watch)
            behind -= samples
    finally:
        window.close()
        session.finish()
