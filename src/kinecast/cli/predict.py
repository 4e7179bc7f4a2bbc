"""`kinecast predict`: a recording streamed through the online predictor."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from tyro.conf import Positional

from kinecast.cli.options import (
    File,
    Horizon,
    ModelFile,
    OptionalFile,
    check_file,
    check_seed,
    read_predictor,
)
from kinecast.cli.progress import progress_bar, status_lines
from kinecast.cli.recordings import FormatName, one_scene, read_recordings
from kinecast.datasets.table import Rows, require_extra, words, write_rows
from kinecast.geometry.scene import Scene
from kinecast.pipeline import stream
from kinecast.predictor import Predictor, PredictorOptions
from kinecast.types import Prediction


def predict(
    path: Positional[Path],
    out: File,
    model: ModelFile = None,
    scene: OptionalFile = None,
    horizon: Horizon = None,
    samples: int = 1000,
    seed: int = 0,
    format: FormatName = None,
) -> None:
    """Streams a recording through the online predictor, frame by frame as the camera gave them.

    Args:
        path: a recording; all its persons are followed.
        out: the table to write, ending in .parquet or .csv, with a row per frame, predicted instant and joint:
            `made` is the frame's stamp, `stamp` the predicted instant, `x, y, z` the mean and `sxx … szz` the
            covariance, `label` the prediction's status.
        model: a model file, or MODULE:FUNCTION that gives your own method (docs/predictor.md).
        scene: obstacles, a YAML file.
        horizon: how far to predict.
        samples: motions drawn per prediction.
        seed: of the draws.
    """
    check_seed(seed)
    check_file(out, (".parquet", ".csv"))
    require_extra(out)
    options = PredictorOptions(samples, seed, horizon)
    obstacles = None if scene is None else Scene.load(scene)
    recordings = one_scene(read_recordings((path,), format), path, "predict")
    predictor = read_predictor(model, obstacles, options)
    predictions: list[Prediction] = []
    total = sum(len(recording.stamps) for recording in recordings)
    with progress_bar("predicting") as progress:
        for prediction in stream(recordings, predictor):
            predictions.append(prediction.without_samples())
            progress(len(predictions), total)
    write_rows(out, _rows(predictions, path, predictor))
    p50, p99 = np.percentile([prediction.diagnostics["milliseconds"] for prediction in predictions], [50, 99])
    print(f"{out}: {len(predictions)} predictions; p50 {p50:.1f} ms, p99 {p99:.1f} ms a frame")
    for line in status_lines(Counter(prediction.status for prediction in predictions)):
        print(f"  {line}")


def _rows(predictions: Sequence[Prediction], source: Path, predictor: Predictor) -> Rows:
    joints = predictions[0].joints
    steps = np.array([len(prediction.times) for prediction in predictions])
    each = steps * len(joints)
    covariance = np.concatenate([prediction.covariance.reshape(-1, 3, 3) for prediction in predictions])
    return Rows(
        stamp=np.repeat(np.concatenate([prediction.times for prediction in predictions]), len(joints)),
        person=words([prediction.person for prediction in predictions], each),
        joint=words(joints * int(steps.sum())),
        position=np.concatenate([prediction.mean.reshape(-1, 3) for prediction in predictions]),
        covariance=covariance[:, *np.triu_indices(3)],  # xx, xy, xz, yy, yz, zz
        label=words([prediction.status.name for prediction in predictions], each),
        made=np.repeat([prediction.stamp for prediction in predictions], each),
        metadata={"what": "predictions", "source": source.name, "rate": 1.0 / predictor.method.dt},
    )
