"""What a figure was measured on, and how it is written down."""

from __future__ import annotations

import json
import os
import platform
import re
from collections.abc import Sequence
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numba
import numpy as np

from kinecast.output import write_atomically

PACKAGES = {"numpy": "numpy", "numba": "numba", "scipy": "scipy", "scikit-learn": "sklearn", "pyswarms": "pyswarms"}
"""What figures depend on, where it is installed, and the name it is imported by."""
RESULTS = Path(__file__).parent / "results"


def facts() -> dict[str, Any]:
    """Cores, load and versions: figures compare only within one run."""
    return {
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "threads": numba.get_num_threads(),
        "load": os.getloadavg()[0],
        "python": platform.python_version(),
        **{name: version(name) for name in PACKAGES if find_spec(PACKAGES[name]) is not None},
    }


def milliseconds(seconds: Sequence[float]) -> dict[str, float]:
    """Least, median, 99th percentile and count."""
    return {
        "least_ms": 1e3 * float(np.min(seconds)),
        "p50_ms": 1e3 * float(np.percentile(seconds, 50)),
        "p99_ms": 1e3 * float(np.percentile(seconds, 99)),
        "count": len(seconds),
    }


def save(name: str, result: dict[str, Any], path: Path | None, before: dict[str, Any]) -> None:
    """Writes a result with the machine's facts beside it, those from before the run too: others may have used it."""
    target = path or RESULTS / f"{name}.json"
    machine = {**facts(), "load_before": before["load"]}
    text = json.dumps({"machine": machine, **result}, indent=1)
    rows = re.compile(r"\[\s+([^\[\]{}]*?)\s+\]")  # a list of numbers or words fits a line
    write_atomically(target, (rows.sub(lambda row: f"[{' '.join(row[1].split())}]", text) + "\n").encode())
