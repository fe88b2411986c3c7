"""Keys and sticks that drive: what is held down now, as actions of the robots."""

from typing import Any

import numpy as np

from relloc_env.extras import extra
from relloc_env.samples import Float

_DRIVE = (
    {"w": (1.0, 0.0), "s": (-1.0, 0.0), "a": (0.0, 1.0), "d": (0.0, -1.0)},
    {"UP": (1.0, 0.0), "DOWN": (-1.0, 0.0), "LEFT": (0.0, 1.0), "RIGHT": (0.0, -1.0)},
)
"""Keys of robots A and B: speed and yaw rate as shares of the robot's limits."""
_SLOW = 0.4
"""Share of the speed with a shift key held down."""
_DEAD = 0.12
"""Part of a stick's way that does nothing: worn sticks do not rest in the middle."""


class Sticks:
    """What is held down, followed from events: keys, and the sticks of gamepads.

    Args:
        robots: number R of robots; one robot answers to both sets of keys, and to either stick.
    """

    def __init__(self, robots: int) -> None:
        with extra("render"):
            import pygame

        self._pygame, self._robots = pygame, robots
        self._keys = [
            {getattr(pygame, f"K_{name}"): np.array(drive) for name, drive in keys.items()} for keys in _DRIVE
        ]
        self._held: set[int] = set()
        self._axes: dict[tuple[int, int], float] = {}
        self._pads: dict[int, Any] = {}
        pygame.joystick.init()

    def take(self, event: Any) -> None:
        """Follow an event of pygame."""
        pygame = self._pygame
        if event.type == pygame.KEYDOWN:
            self._held.add(event.key)
        elif event.type == pygame.KEYUP:
            self._held.discard(event.key)
        elif event.type == pygame.WINDOWFOCUSLOST:
            self._held.clear()
        elif event.type == pygame.JOYDEVICEADDED:
            pad = pygame.joystick.Joystick(event.device_index)
            self._pads[pad.get_instance_id()] = pad
        elif event.type == pygame.JOYDEVICEREMOVED:
            self._pads.pop(event.instance_id, None)
            self._axes = {key: value for key, value in self._axes.items() if key[0] != event.instance_id}
        elif event.type == pygame.JOYAXISMOTION:
            self._axes[event.instance_id, event.axis] = event.value

    def action(self) -> Float:
        """(R, 2) speed and yaw rate, in [-1, 1]."""
        both = np.zeros((2, 2))
        for robot, keys in enumerate(self._keys):
            for key in self._held & keys.keys():
                both[robot] += keys[key]
        for (pad, axis), value in self._axes.items():
            driven_robot, upright = self._stick(pad, axis)
            if driven_robot is not None and abs(value) > _DEAD:
                both[driven_robot, 0 if upright else 1] -= np.sign(value) * (abs(value) - _DEAD) / (1.0 - _DEAD)
        if self._held & {self._pygame.K_LSHIFT, self._pygame.K_RSHIFT}:
            both *= _SLOW
        if self._robots == 1:
            both = both.sum(axis=0, keepdims=True)
        driven: Float = np.clip(both, -1.0, 1.0)
        return driven

    def _stick(self, pad: int, axis: int) -> tuple[int | None, bool]:
        """Which robot an axis drives, and whether it is upright; pads with triggers have these between the sticks."""
        known = self._pads.get(pad)
        right = 3 if known is not None and known.get_numaxes() > 4 else 2
        if axis in (0, 1):
            return 0, axis == 1
        return (1, axis == right + 1) if axis in (right, right + 1) else (None, False)
