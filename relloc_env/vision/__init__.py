"""Cameras that take pictures: rendered images of the world, and detectors that find the targets in them.

OpenCV is imported here alone, by the detectors that need it (extra `vision`).
"""

from relloc_env.vision.protocol import Detections, Detector, View, make_detector, view_of

__all__ = ["Detections", "Detector", "View", "make_detector", "view_of"]
