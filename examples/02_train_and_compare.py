"""Train and compare.

Methods trained on one recording and scored on another, all on the same windows.

Shows: training from Python, the scores `kinecast evaluate` reports, a model saved and loaded again.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from kinecast import Predictor, PredictorOptions, Scene
from kinecast.datasets.loading import shipped_clips
from kinecast.datasets.windows import WindowOptions
from kinecast.evaluation.scoring import EvaluationOptions, TestRecording, evaluate
from kinecast.pipeline import training_windows
from kinecast.prediction.methods import card_of, save_method, train

METHODS = ("zero_velocity", "damped_velocity", "ridge", "ridge_constrained")


def main() -> None:
    known, unknown = shipped_clips()  # somebody who fetches cubes, somebody who is handed something
    scene = Scene.from_yaml("table: {height: 0.0}")  # everything below is forbidden
    windows = WindowOptions(stride=10)  # 0.2 s seen, 0.5 s predicted, 30 Hz, three test windows a second

    data = training_windows([known], windows, scene)
    methods = train(METHODS, data)
    limits = data.limits
    print(f"trained on {len(data)} windows of {known.name}, tested on {unknown.name}\n")

    # Methods that learn from the person in view are shown every frame; scores are taken at every tenth.
    tests = TestRecording.of([unknown], windows)
    results, _ = evaluate(methods, tests, scene, EvaluationOptions(samples=200, repeats=0, limits=limits))
    print(f"{'':20} MPJPE mm  CRPS mm     NLL  inside 90 %  violations (range, speed, scene)")
    for name, scores in results["methods"].items():
        broken = "  ".join(f"{100 * share:.2f} %" for share in scores["violations"].values())
        print(
            f"{name:20} {scores['mpjpe_mm']:8.1f} {scores['crps_mm']:8.1f} {scores['nll']:7.2f} "
            f"{100 * scores['coverage']['0.9']:10.1f} %  {broken}"
        )

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ridge_constrained.npz"
        method = methods["ridge_constrained"]
        save_method(path, card_of("ridge_constrained", method, data, "", [known.name]), method)
        predictor = Predictor.load(path, scene, PredictorOptions(samples=300))
        print(f"\nsaved and loaded: {path.name}, {path.stat().st_size / 1e3:.0f} kB, plain arrays and a JSON card")
    print(f"it sees {predictor.method.frames} frames and predicts {predictor.method.steps}")


if __name__ == "__main__":
    main()
