"""`kinecast demo`: generated people at a table, predicted, scored and drawn; needs no data and no network."""

from __future__ import annotations

from pathlib import Path

from kinecast import __version__
from kinecast.cli.destination import check_folder
from kinecast.cli.options import Folder
from kinecast.cli.progress import progress_bar
from kinecast.datasets.synthetic import SyntheticOptions, generate, table_scene
from kinecast.datasets.windows import WindowOptions, all_windows
from kinecast.evaluation.protocol import EvaluationOptions
from kinecast.evaluation.tables import format_table
from kinecast.pipeline import every_frame
from kinecast.prediction.methods import shipped_methods

__all__ = ["demo"]

SEED = 7


def demo(out: Folder = Path("kinecast-demo")) -> None:
    """Generates people at a table, predicts their arms, scores it, draws it, and says where it all is.

    Args:
        out: folder for the report and the pictures.
    """
    from kinecast.evaluation.run import run_evaluation  # here, since drawing is an extra other commands do without

    check_folder(out)
    people = SyntheticOptions(subjects=2, recordings=2, duration=10.0)
    scene = table_scene(people)
    windows = WindowOptions()
    recordings = generate(people, SEED)
    parts = list(all_windows(recordings, windows))
    histories = list(all_windows(recordings, every_frame(windows)))
    card, methods = shipped_methods()
    options = EvaluationOptions(samples=500, repeats=5, repeat_windows=20, limits=card.limits)
    settings = {
        "version": __version__,
        "train": list(card.trained_on),
        "rate": windows.rate,
        "window": windows.window,
        "horizon": windows.horizon,
        "stride": windows.stride,
        "label": None,
        "scene": "generated table",
    }
    with progress_bar("predicting") as progress:
        metrics = run_evaluation(out, methods, parts, histories, scene, options, settings, progress)
    print(format_table(metrics))
    print(f"report: {out / 'report.html'}")
    print(f"pictures: {out / 'prediction.png'}, {out / 'prediction.gif'}")
