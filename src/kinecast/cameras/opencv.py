"""OpenCV, or what brings it."""

from kinecast.errors import MissingExtraError

try:
    import cv2 as cv2
except ImportError as error:  # pragma: no cover - the tests install it
    raise MissingExtraError("pictures of cameras", "camera") from error
