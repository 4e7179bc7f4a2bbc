"""Any predictor, constrained.

A predictor that knows nothing of kinecast, here nearest neighbours, becomes a distribution that keeps joint ranges,
joint speeds and the scene.

Shows: the one method a foreign model must have (`mean`, from windows to futures), the spread fitted around it, and the
same model free and constrained side by side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinecast import Scene
from kinecast.datasets.loading import shipped_clips
from kinecast.datasets.windows import WindowOptions
from kinecast.evaluation.scoring import EvaluationOptions, TestRecording, evaluate
from kinecast.pipeline import training_windows
from kinecast.prediction.gaussian import PostureGaussian


@dataclass(frozen=True)
class NearestNeighbours:
    """The mean of what followed the training windows that moved most alike."""

    inputs: np.ndarray
    displacements: np.ndarray
    count: int = 40

    @staticmethod
    def fit(windows: np.ndarray, futures: np.ndarray, folds: np.ndarray) -> NearestNeighbours:  # noqa: ARG004
        """Remembers every window; the folds are for models that tune themselves."""
        return NearestNeighbours(features(windows), futures - windows[:, -1:])

    def mean(self, windows: np.ndarray) -> np.ndarray:
        """(W, N, D) windows in, (W, T, D) means out: all that the constraint stage asks of a model."""
        found = np.empty((len(windows), *self.displacements.shape[1:]))
        for row, (window, wanted) in enumerate(zip(windows, features(windows), strict=True)):
            distance = np.square(self.inputs - wanted).sum(axis=1)
            nearest = np.argpartition(distance, self.count)[: self.count]
            found[row] = window[-1] + self.displacements[nearest].mean(axis=0)
        return found

    def to_arrays(self) -> dict[str, np.ndarray]:
        """What a saved model would hold."""
        return {"inputs": self.inputs, "displacements": self.displacements}


def features(windows: np.ndarray) -> np.ndarray:
    """(W, F) the steps of a window, and a little of where it ends."""
    steps = np.diff(windows, axis=1).reshape(len(windows), -1)
    return np.concatenate([steps, 0.05 * windows[:, -1]], axis=1)


def main() -> None:
    known, unknown = shipped_clips()
    scene = Scene.from_yaml("table: {height: 0.0}")  # everything below is forbidden
    windows = WindowOptions(stride=10)
    data = training_windows([known], windows, scene)
    limits, noise = data.limits, data.noise

    methods = {
        "free": PostureGaussian.fit(NearestNeighbours.fit, data, noise, None),
        "constrained": PostureGaussian.fit(NearestNeighbours.fit, data, noise, limits),
    }
    tests = TestRecording.of([unknown], windows)
    results, _ = evaluate(methods, tests, scene, EvaluationOptions(samples=200, repeats=0, limits=limits))
    print(f"{'neighbours':12} MPJPE mm     NLL  inside 90 %  violations (range, speed, scene)")
    for name, scores in results["methods"].items():
        broken = "  ".join(f"{100 * share:.2f} %" for share in scores["violations"].values())
        print(
            f"{name:12} {scores['mpjpe_mm']:8.1f} {scores['nll']:7.2f} "
            f"{100 * scores['coverage']['0.9']:10.1f} %  {broken}"
        )


if __name__ == "__main__":
    main()
