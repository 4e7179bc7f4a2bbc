"""Each extra alone: with its packages and those of the core, and nothing else, all it is for can be imported.

The packages of the other extras are installed where tests run; here they are hidden.
"""

from __future__ import annotations

import json
import subprocess
import sys
from functools import cache
from importlib.metadata import PackageNotFoundError, packages_distributions, requires

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

EXTRAS = ("parquet", "train", "robot", "view", "live", "webcam", "camera", "ros", "cluster", "ur")
IMPORTS = """
import importlib, json, os, pkgutil, sys, warnings
import numba, rich.progress, scipy.optimize, scipy.spatial, scipy.stats, threadpoolctl, tyro, yaml  # once for all

warnings.simplefilter("ignore")

class Hiding:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in hidden:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

for extra, hidden in json.loads(sys.argv[1]).items():
    sys.stdout.flush()
    if os.fork():
        os.wait()
        continue
    hidden = set(hidden)
    for name in [name for name in sys.modules if name.partition(".")[0] in hidden]:
        del sys.modules[name]
    sys.meta_path.insert(0, Hiding())
    import kinecast
    from kinecast.errors import MissingExtraError

    for module in pkgutil.walk_packages(kinecast.__path__, "kinecast.", onerror=lambda name: None):
        try:
            importlib.import_module(module.name)
        except MissingExtraError as error:
            print(extra, error.args[1])
    print(extra, "done", flush=True)
    os._exit(0)
"""
"""A process for each extra, which imports everything and says what extras it lacks."""


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


@pytest.fixture(scope="module")
def imported() -> tuple[set[tuple[str, str]], str]:
    """Each extra with every other that it lacks, and with "done" once all was imported; and what was wrong."""
    hidden = {extra: list[str]() for extra in EXTRAS}
    installed = {name: {canonicalize_name(owner) for owner in of} for name, of in packages_distributions().items()}
    for extra in EXTRAS:
        there, _ = brought(extra)
        hidden[extra] += [name for name in installed.keys() - sys.stdlib_module_names if not there & installed[name]]
    command = [sys.executable, "-W", "ignore", "-c", IMPORTS, json.dumps(hidden)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return {(extra, what) for extra, what in map(str.split, done.stdout.splitlines())}, done.stderr


@pytest.mark.parametrize("extra", EXTRAS)
def test_an_extra_alone_brings_all_that_it_is_for(extra: str, imported: tuple[set[tuple[str, str]], str]) -> None:
    missing = {what for one, what in imported[0] if one == extra}
    assert "done" in missing, imported[1][-2000:]  # nothing but a missing extra keeps a module from being imported
    assert len(missing) > 1, "the packages of the other extras were not hidden"
    assert not missing & brought(extra)[1]
