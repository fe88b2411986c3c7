"""Pictures of an environment: a `Scene` is what they show, a `Renderer` draws it (needs the extra `render`)."""

from relloc_env.rendering.animation import save_animation
from relloc_env.rendering.renderer import Renderer
from relloc_env.rendering.scene import CameraGeometry, Scene, Strip, robot_colour, robot_name, target_colours

__all__ = [
    "CameraGeometry",
    "Renderer",
    "Scene",
    "Strip",
    "robot_colour",
    "robot_name",
    "save_animation",
    "target_colours",
]
