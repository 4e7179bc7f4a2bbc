"""Skeletons in and predictions out by ROS 1, ROS 2, DDS and bags: conversions apart from nodes. Needs the extra `ros`.

Every message is a mapping of field names to values on its way out and a plain object on its way in; `messages` alone
makes bytes of the one and takes the other from bytes, and a node carries nothing but bytes.
"""

from kinecast.errors import MissingExtraError

try:
    import cyclonedds  # noqa: F401
    import rosbags.typesys  # noqa: F401
except ImportError as error:  # pragma: no cover - the tests install it
    raise MissingExtraError("ROS", "ros") from error
