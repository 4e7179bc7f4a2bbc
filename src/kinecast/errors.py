"""Every error kinecast raises: one root, a leaf for each thing a caller may want to catch apart."""

from __future__ import annotations


class KinecastError(Exception):
    """Root of all errors kinecast raises on purpose. The command line turns one into exit code 2."""


class DatasetError(KinecastError, ValueError):
    """A recording or scene file that does not match its format, or data too poor to use.

    Args:
        where: the file, and the line, frame or column where known, e.g. `"a.csv, line 7"`.
        problem: what was found and what was expected.
    """

    def __init__(self, where: object, problem: str) -> None:
        super().__init__(str(where), problem)
        self.where, self.problem = self.args

    def __str__(self) -> str:
        return f"{self.where}: {self.problem}"


class ModelError(KinecastError, ValueError):
    """A model file that cannot be read, is not kinecast's, or does not fit the recording."""


class OptionError(KinecastError, ValueError):
    """An option outside its allowed range; the message names the option, the value and the range."""


class MissingExtraError(KinecastError, ImportError):
    """A feature whose optional packages are not installed; the message is the pip command that mends it."""

    def __init__(self, feature: str, extra: str) -> None:
        super().__init__(feature, extra)

    def __str__(self) -> str:
        return "{} needs optional packages: pip install 'kinecast[{}]'".format(*self.args)


class DownloadError(KinecastError, OSError):
    """A download that failed, was incomplete, or whose checksum is wrong."""


class ClusterError(KinecastError, OSError):
    """A cluster that cannot be reached, has no fit workers, or loses them again and again."""


class ArmError(KinecastError, OSError):
    """An arm that cannot be reached, does not speak its protocol, or is not what it must be before it may move."""
