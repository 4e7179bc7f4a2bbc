"""Each extra alone: with its packages and those of the core, and nothing else, all it is for can be imported.

The packages of the other extras are installed where tests run; here they are hidden.
"""

from __future__ import annotations

import subprocess
import sys
from functools import cache
from importlib.metadata import PackageNotFoundError, packages_distributions, requires

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

EXTRAS = ("parquet", "train", "robot", "view", "live", "webcam", "camera", "ros", "cluster", "ur")
IMPORTS = """
import importlib, pkgutil, sys

hidden = set(sys.argv[1].split(","))

class Hiding:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in hidden:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Hiding())
import kinecast
from kinecast.errors import MissingExtraError

for module in pkgutil.walk_packages(kinecast.__path__, "kinecast.", onerror=lambda name: None):
    try:
        importlib.import_module(module.name)
    except MissingExtraError as error:
        print(error.args[1])
"""


owners_of_modules = cache(packages_distributions)


@cache
def needs(name: str) -> list[Requirement]:
    """What a package requires; nothing of one for another system, or Python."""
    try:
        return [Requirement(line) for line in requires(name) or []]
    except PackageNotFoundError:
        return []


def brought(extra: str) -> tuple[set[str], set[str]]:
    """Names of everything that pip installs for the core and an extra, and of the extras that it brings."""
    waiting, seen = [("kinecast", frozenset({extra}))], set()
    while waiting:
        name, extras = each = waiting.pop()
        if each in seen:
            continue
        seen.add(each)
        for need in needs(name):
            if need.marker is None or any(need.marker.evaluate({"extra": one}) for one in ("", *extras)):
                waiting.append((canonicalize_name(need.name), frozenset(need.extras)))
    return {name for name, _ in seen}, set().union(*(extras for name, extras in seen if name == "kinecast"))


@pytest.mark.parametrize("extra", EXTRAS)
def test_an_extra_alone_brings_all_that_it_is_for(extra: str) -> None:
    there, extras = brought(extra)
    hidden = [
        name
        for name, owners in owners_of_modules().items()
        if not there & {canonicalize_name(owner) for owner in owners} and name not in sys.stdlib_module_names
    ]
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", IMPORTS, ",".join(hidden)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]  # nothing but a missing extra keeps a module from being imported
    missing = set(done.stdout.split())
    assert missing, "the packages of the other extras were not hidden"
    assert not missing & extras
