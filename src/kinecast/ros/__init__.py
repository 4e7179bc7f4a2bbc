"""Skeletons in and predictions out by ROS 1, ROS 2, DDS and bags. Needs the extra `ros`.

A message is a mapping of field names to values on its way out and an object of rosbags' on its way in; `messages` makes
bytes of the one and reads the other from bytes, and a transport carries nothing but bytes.
"""

from kinecast.errors import MissingExtraError

try:
    import cyclonedds  # noqa: F401
    import rosbags.typesys  # noqa: F401
except ImportError as error:  # pragma: no cover - the tests install it
    raise MissingExtraError("ROS", "ros") from error
