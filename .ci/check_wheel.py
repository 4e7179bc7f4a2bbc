"""Installs a wheel alone into an empty environment, of this Python or of each that is here, and tries it there.

python .ci/check_wheel.py dist/kinecast-VERSION-py3-none-any.whl [--every-python]

The README's first block runs on the core alone; every module imports, or its error names the pip command of an extra;
so do the commands that need one.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LARGEST = 10e6
"""Bytes of a wheel."""
CLIP = "kinecast/data/clips/pick_and_place.csv.xz"
COMMANDS = {
    "train": f"train {CLIP} --out own.npz --method gp_xyz",
    "robot": "simulate",
    "live": f"live --source {CLIP} --sink ws://127.0.0.1:0",
    "cluster": f"train {CLIP} --out own.npz --method ridge --cluster local:1",
    "parquet": f"convert {CLIP} own.parquet",
    "camera": "calibrate --board board.png",
}
"""Something that needs each extra, in the folder of the installed packages."""
IMPORTS = """
import importlib, pkgutil, sys
import kinecast
from kinecast.errors import MissingExtraError

extras = set()
for module in pkgutil.walk_packages(kinecast.__path__, "kinecast.", onerror=lambda name: None):
    try:
        importlib.import_module(module.name)
    except MissingExtraError as error:
        assert f"pip install 'kinecast[{error.args[1]}]'" in str(error), error
        extras.add(error.args[1])
print("core only; extras that modules ask for:", *sorted(extras))
"""


def main() -> None:
    """The Python that runs this, or every one from 3.11 on: a minute or two each."""
    wheel = Path(sys.argv[1]).resolve()
    size = wheel.stat().st_size
    if size > LARGEST:
        sys.exit(f"{wheel.name} has {size / 1e6:.1f} MB, allowed are {LARGEST / 1e6:g}")
    print(f"{wheel.name}: {size / 1e6:.1f} MB")
    metadata = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    versions = re.findall(r'"Programming Language :: Python :: (3\.\d+)"', metadata)
    wanted = versions if "--every-python" in sys.argv[2:] else []
    found = {version: path for version in wanted if (path := interpreter(version))}
    found.setdefault(".".join(map(str, sys.version_info[:2])), sys.executable)
    for path in found.values():
        with tempfile.TemporaryDirectory() as folder:
            check(path, wheel, Path(folder))
    missing = [version for version in wanted if version not in found]
    print("not tried, since not here:", *missing) if missing else None


def interpreter(version: str) -> str | None:
    """One that starts: on the path, or one of pyenv's."""
    paths = [shutil.which(f"python{version}"), *Path.home().glob(f".pyenv/versions/{version}.*/bin/python")]
    for path in filter(None, paths):
        if subprocess.run([path, "-c", "import venv"], capture_output=True, check=False).returncode == 0:
            return str(path)
    return None


def check(python: str, wheel: Path, folder: Path) -> None:
    """An environment of its own with nothing but the wheel and what it needs."""
    began = time.monotonic()
    run(python, "-m", "venv", folder / "venv", folder=folder)
    inside = folder / "venv" / "bin" / "python"
    pip = (inside, "-m", "pip", "install", "--quiet", "--no-compile", "--disable-pip-version-check")
    run(*pip, "-c", ROOT / "constraints.txt", wheel, folder=folder)
    installed = time.monotonic()
    block = re.search(r"^```python\n(.*?)^```$", (ROOT / "README.md").read_text(encoding="utf-8"), re.M | re.S)
    assert block is not None
    print(run(inside, "-W", "error", "-c", block[1], folder=folder))
    print(run(inside, "-W", "ignore", "-c", IMPORTS, folder=folder))
    place = run(inside, "-c", "import kinecast; print(kinecast.__path__[0])", folder=folder).strip()
    for extra, words in COMMANDS.items():
        done = subprocess.run(
            [folder / "venv" / "bin" / "kinecast", *words.replace(CLIP, f"{place}/{CLIP.partition('/')[2]}").split()],
            cwd=folder, capture_output=True, text=True, timeout=300, check=False,
        )  # fmt: skip
        said = "".join(done.stderr.split())
        if done.returncode != 2 or f"pipinstall'kinecast[{extra}]'" not in said:
            sys.exit(f"kinecast {words}: exit code {done.returncode}, without the pip command: {done.stderr}")
    version = run(inside, "--version", folder=folder).strip()
    print(f"{version}: installed in {installed - began:.0f} s, tried in {time.monotonic() - installed:.0f} s")


def run(*command: object, folder: Path) -> str:
    """What it prints; the end where it fails."""
    done = subprocess.run([*map(str, command)], cwd=folder, capture_output=True, text=True, timeout=900, check=False)
    if done.returncode != 0:
        sys.exit(f"{' '.join(map(str, command))[:200]}\n{done.stdout}{done.stderr}")
    return done.stdout


if __name__ == "__main__":
    main()
