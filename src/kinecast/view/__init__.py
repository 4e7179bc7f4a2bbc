"""The views in the browser."""

from kinecast.errors import MissingExtraError

try:
    import viser  # noqa: F401
except ImportError as error:  # pragma: no cover - the tests install it
    raise MissingExtraError("the browser view", "view") from error
