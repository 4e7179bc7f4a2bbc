"""Fixtures shared by every test."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def data_root() -> Path:
    """Folder of real recordings: $KINECAST_DATA, else ../shared/data beside the checkout."""
    root = Path(os.environ.get("KINECAST_DATA", REPOSITORY.parent / "shared" / "data"))
    if not root.is_dir():
        pytest.skip(f"no recordings: {root.name} not found; set KINECAST_DATA to the folder of recordings")
    return root
