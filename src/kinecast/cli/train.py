"""`kinecast train`: recordings in, one model file out."""

from __future__ import annotations

from kinecast.cli.options import (
    Action,
    ClusterPlace,
    File,
    MethodName,
    OptionalFile,
    What,
    check_file,
    check_seed,
    worker_pool,
)
from kinecast.cli.progress import progress_bar
from kinecast.cli.recordings import FormatName, read_recordings
from kinecast.datasets.windows import WindowOptions
from kinecast.geometry.scene import Scene
from kinecast.pipeline import training_windows
from kinecast.prediction.methods import card_of, check_names, save_method
from kinecast.prediction.methods import train as fit


def train(
    paths: What,
    out: File,
    method: MethodName = "kinecast",
    rate: float = 30.0,
    window: float = 0.2,
    horizon: float = 0.5,
    label: Action = None,
    scene: OptionalFile = None,
    seed: int = 0,
    format: FormatName = None,
    cluster: ClusterPlace = None,
) -> None:
    """Trains one method on recordings and writes it to a file, whole or not at all.

    Args:
        paths: recordings, or folders of them. A folder is a collection, of one place and sensor; to train on several,
            give each by itself.
        out: the model file, ending in .npz.
        rate: frames per second the model works at.
        window: how much is observed [s].
        horizon: how much is predicted [s].
        label: train only where the recordings' label is this action.
        scene: obstacles, a YAML file; windows that end inside one are left out.
        seed: of everything random.
        cluster: spread the work over a Dask cluster that you trust: a scheduler's address, or N processes of this
            machine. The model is the same to the last bit.
    """
    check_names([method])
    check_seed(seed)
    check_file(out, (".npz",))
    options = WindowOptions(rate=rate, window=window, horizon=horizon, label=label)
    obstacles = None if scene is None else Scene.load(scene)
    recordings = read_recordings(paths, format)
    with worker_pool(cluster) as workers:
        with progress_bar("cutting windows") as progress:
            data = training_windows(recordings, options, obstacles, progress, workers)
        with progress_bar(f"training {method}") as progress:
            trained = fit([method], data, seed, progress, workers)[method]
    names = [recording.name for recording in recordings]
    save_method(out, card_of(method, trained, data, label or "", names, seed=seed), trained)
    print(f"{out}: {method}, trained on {len(data)} windows of {len(names)} recording{'s' * (len(names) != 1)}")
