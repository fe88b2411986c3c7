"""Windows of this process: each shows its own pictures, whatever others do with pygame."""

import os
import weakref
from typing import TYPE_CHECKING, Any

from relloc_env.extras import extra

if TYPE_CHECKING:
    from pygame import Surface

_windows: "weakref.WeakSet[Window]" = weakref.WeakSet()


class NoDisplayError(OSError, RuntimeError):
    """There is nothing to open a window on."""


def start_display() -> Any:
    """Return pygame with its display started.

    Raises:
        NoDisplayError: no screen is there, and the user did not choose to go on without one (`SDL_VIDEODRIVER=dummy`).
    """
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    with extra("render"):
        import pygame

    running = pygame.display.get_init()
    try:
        pygame.display.init()
    except pygame.error as error:
        raise NoDisplayError(str(error)) from error
    driver = pygame.display.get_driver()
    chosen = os.environ.get("SDL_VIDEODRIVER", "") + "," + os.environ.get("SDL_VIDEO_DRIVER", "")
    if driver in {"dummy", "offscreen"} and driver not in chosen.split(","):  # what SDL falls back on
        if not running:
            pygame.display.quit()
        raise NoDisplayError("no screen was found (SDL_VIDEODRIVER=dummy goes on without one)")
    return pygame


class Window:
    """Shows pictures until somebody closes it: its user, `close`, or who stops pygame's display.

    The first window of the process is pygame's display, others are windows of their own.

    Args:
        size: [px] width and height.

    Attributes:
        closed: whether it is gone.
        lost: whether that came from elsewhere: somebody stopped pygame's display.

    Raises:
        NoDisplayError: see `start_display`.
    """

    def __init__(self, size: tuple[int, int]) -> None:
        self.closed = self.lost = False
        self._size = size
        self._open()

    def _open(self) -> None:
        self._pygame = pygame = start_display()
        self.own: Any = None
        """Where this is not pygame's display, the window."""
        self.swept = False
        """Whether the display was stopped by another window of this package: then this one opens again."""
        try:
            if pygame.display.get_surface() is None:
                self._surface: Surface = pygame.display.set_mode(self._size)
                pygame.display.set_caption("relloc_env")
            else:
                self.own = pygame.Window("relloc_env", self._size)
                self._surface = self.own.get_surface()
        except pygame.error as error:
            raise NoDisplayError(str(error)) from error
        # Drawing on a window after its display was stopped ends the process: this surface is new after each start.
        self._display = pygame.display.get_surface()
        _windows.add(self)

    @property
    def _alive(self) -> bool:
        return self._pygame.display.get_init() and self._pygame.display.get_surface() is self._display

    def show(self, picture: "Surface") -> None:
        """Obey what users did with windows, and show a picture unless this one is gone."""
        if self.swept:
            self._open()
        if self._alive:
            _obey(self._pygame.event.get(), self._pygame)
        elif not self.closed:
            self.closed = self.lost = True
            _windows.discard(self)
        if not self.closed:
            if self.swept:
                self._open()
            self._surface.blit(picture, (0, 0))
            (self.own or self._pygame.display).flip()

    def close(self) -> None:
        """Let the window go; may be called twice."""
        if self.closed:
            return
        self.closed = True
        _windows.discard(self)
        if not self._alive:
            return
        if self.own is not None:
            self.own.destroy()
        else:
            self._pygame.display.quit()  # with all windows: the others of this package open again
            for other in _windows:
                other.swept = True


def _obey(events: list[Any], pygame: Any) -> None:
    """Close what users closed, by the window's button or Escape; without a window, all of them."""
    for event in events:
        escape = event.type == pygame.KEYDOWN and event.key == pygame.K_ESCAPE
        if not (escape or event.type in {pygame.QUIT, pygame.WINDOWCLOSE}):
            continue
        meant = getattr(event, "window", None)
        ours = [window for window in _windows if window.own is not None and window.own is meant]
        if meant is not None and not ours:
            ours = [window for window in _windows if window.own is None]
        for window in ours if meant is not None else list(_windows):
            window.close()
