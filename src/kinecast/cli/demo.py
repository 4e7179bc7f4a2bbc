"""`kinecast demo`: the shipped models on the clips of people that come with kinecast; needs no data, no network."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from kinecast.cli.evaluate import evaluate
from kinecast.cli.options import Folder
from kinecast.prediction.methods import SHIPPED


def demo(out: Folder = Path("kinecast-demo")) -> None:
    """Predicts the arms of real people at work, scores and draws that, and says where it all is.

    Args:
        out: folder for the report and the pictures.
    """
    with resources.as_file(resources.files("kinecast") / "data") as data:
        models = tuple(data / "models" / f"{name}.npz" for name in SHIPPED)
        evaluate((data / "clips",), out, model=models, samples=200, repeats=2)
    print(f"pictures: {out / 'prediction.png'}, {out / 'prediction.gif'}")
