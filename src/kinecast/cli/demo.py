"""`kinecast demo`: generated people at a table, predicted, scored and drawn; needs no data and no network."""

from __future__ import annotations

from pathlib import Path

from kinecast.cli.evaluate import score
from kinecast.cli.method_set import MethodSet
from kinecast.cli.options import Folder, check_folder
from kinecast.datasets.synthetic import SyntheticOptions, generate, table_scene
from kinecast.datasets.windows import WindowOptions, all_windows
from kinecast.evaluation.scoring import EvaluationOptions
from kinecast.pipeline import every_frame
from kinecast.prediction.methods import shipped_methods

SEED = 7


def demo(out: Folder = Path("kinecast-demo")) -> None:
    """Generates people at a table, predicts their arms, scores it, draws it, and says where it all is.

    Args:
        out: folder for the report and the pictures.
    """
    check_folder(out)
    people = SyntheticOptions(subjects=2, recordings=2, duration=10.0)
    card, methods = shipped_methods()
    options = EvaluationOptions(samples=500, repeats=5, repeat_windows=20, limits=card.limits)
    recordings, windows = generate(people, SEED), WindowOptions()
    parts, histories = all_windows(recordings, windows), all_windows(recordings, every_frame(windows))
    compared = MethodSet(methods, card.limits, card.trained_on, windows)
    score(out, compared, parts, histories, table_scene(people), options, {"models": {}, "scene": "generated table"})
    print(f"pictures: {out / 'prediction.png'}, {out / 'prediction.gif'}")
