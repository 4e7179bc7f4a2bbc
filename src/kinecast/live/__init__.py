"""The loop of `kinecast live`, what it sends and where to. Needs the extra `live`."""

from kinecast.errors import MissingExtraError

try:
    import mcap  # noqa: F401
    import msgspec  # noqa: F401
    import websockets  # noqa: F401
except ImportError as error:
    raise MissingExtraError("kinecast live", "live") from error
