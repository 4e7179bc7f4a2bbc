"""`kinecast predict`: a recording streamed through the online predictor."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from kinecast.cli.progress import progress_bar
from kinecast.datasets.loading import load
from kinecast.datasets.table_file import Rows, Words, write_rows
from kinecast.errors import OptionError
from kinecast.geometry.scene import Scene
from kinecast.pipeline import stream
from kinecast.prediction.predictor import Predictor, PredictorOptions
from kinecast.types import Prediction, Status

__all__ = ["predict"]


def predict(
    path: Annotated[Path, tyro.conf.Positional],
    out: Path,
    model: Path | None = None,
    scene: Path | None = None,
    samples: int = 1000,
    seed: int = 0,
    format: str | None = None,
) -> None:
    """Streams a recording through the online predictor, frame by frame as the camera gave them.

    Writes a table with one row per predicted instant and joint: `stamp` is the predicted instant, `label` the
    status, `x, y, z` the mean and `sxx … szz` the covariance; the metadata says what made it. The frame a row was
    predicted from is its `made` column in the metadata's order: predictions follow one another, T instants each.

    Args:
        path: a recording.
        out: the table to write, ending in .parquet or .csv.
        model: a model file; the one shipped with kinecast if left out.
        scene: obstacles, a YAML file.
        samples: motions drawn per prediction.
        seed: of the draws.
        format: read the recording as this format instead of finding it by content.
    """
    if out.suffix not in (".parquet", ".csv"):
        raise OptionError(f"--out {out}: a table ends in .parquet or .csv")
    obstacles = None if scene is None else Scene.load(scene)
    recordings = load(path, format)
    options = PredictorOptions(samples=samples, seed=seed)
    predictor = Predictor.load(model, obstacles, options) if model else Predictor.shipped(obstacles, options)
    predictions: list[Prediction] = []
    total = sum(len(recording.stamps) for recording in recordings)
    with progress_bar("predicting") as progress:
        for recording in recordings:
            for prediction in stream(recording, predictor):
                predictions.append(_summary_only(prediction))
                progress(len(predictions), total)
    write_rows(out, _rows(predictions, path, predictor))
    milliseconds = [prediction.diagnostics["milliseconds"] for prediction in predictions]
    counts = Counter(prediction.status for prediction in predictions)
    print(f"{out}: {len(predictions)} predictions; p50 {np.percentile(milliseconds, 50):.1f} ms, "
          f"p99 {np.percentile(milliseconds, 99):.1f} ms a frame")  # fmt: skip
    for status, count in counts.most_common():
        print(f"  {status.name}: {count}" + ("" if status is Status.OK else f"  ({status.advice})"))


def _summary_only(prediction: Prediction) -> Prediction:
    """Without samples and density, so that a long recording fits in memory."""
    return Prediction(
        stamp=prediction.stamp, times=prediction.times, samples=prediction.samples[:0], mean=prediction.mean,
        covariance=prediction.covariance, joints=prediction.joints, person=prediction.person,
        status=prediction.status, diagnostics=prediction.diagnostics,
    )  # fmt: skip


def _rows(predictions: list[Prediction], source: Path, predictor: Predictor) -> Rows:
    joints = predictions[0].joints
    steps = [len(prediction.times) for prediction in predictions]
    upper = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
    covariance = np.concatenate([prediction.covariance.reshape(-1, 3, 3) for prediction in predictions])
    person = [prediction.person for prediction in predictions]
    status = [prediction.status.name for prediction in predictions]
    each = np.array(steps) * len(joints)
    return Rows(
        stamp=np.repeat(np.concatenate([prediction.times for prediction in predictions]), len(joints)),
        person=Words.of(np.repeat(person, each).tolist()),
        joint=Words.of(joints * sum(steps)),
        position=np.concatenate([prediction.mean.reshape(-1, 3) for prediction in predictions]),
        covariance=np.stack([covariance[:, a, b] for a, b in upper], axis=1),
        label=Words.of(np.repeat(status, each).tolist()),
        metadata={
            "what": "predictions",
            "source": source.name,
            "rate": 1.0 / predictor.method.dt,
            "made": [prediction.stamp for prediction in predictions],
            "instants": steps,
        },
    )
