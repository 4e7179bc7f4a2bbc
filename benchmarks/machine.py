"""What a figure was measured on, and how it is written down."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numba
import numpy as np

RESULTS = Path(__file__).parent / "results"


def facts() -> dict[str, Any]:
    """Cores, load and versions: figures compare only within one run."""
    return {
        "cores": os.cpu_count(),
        "threads": numba.get_num_threads(),
        "load": os.getloadavg()[0],
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba.__version__,
    }


def milliseconds(seconds: Sequence[float]) -> dict[str, float]:
    """Median, 99th percentile and count."""
    return {
        "p50_ms": 1e3 * float(np.percentile(seconds, 50)),
        "p99_ms": 1e3 * float(np.percentile(seconds, 99)),
        "count": len(seconds),
    }


def save(name: str, result: dict[str, Any], path: Path | None) -> None:
    """Writes a result with the machine's facts beside it."""
    target = path or RESULTS / f"{name}.json"
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(json.dumps({"machine": facts(), **result}, indent=1) + "\n")
