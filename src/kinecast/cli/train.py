"""`kinecast train`: recordings in, one model file out."""

from __future__ import annotations

from kinecast.cli.crew import crew
from kinecast.cli.destination import check_file
from kinecast.cli.options import Action, ClusterPlace, File, FormatName, MethodName, SceneFile, Switch, What, check_seed
from kinecast.cli.progress import progress_bar
from kinecast.cli.recordings import read_recordings
from kinecast.datasets.windows import WindowOptions
from kinecast.errors import OptionError
from kinecast.geometry.scene import Scene
from kinecast.pipeline import training_windows, training_windows_by_action
from kinecast.prediction.methods import TrainingOptions, card_of, check_names, save_method, with_actions
from kinecast.prediction.methods import train as fit

__all__ = ["train"]


def train(
    paths: What,
    out: File,
    method: MethodName = "kinecast",
    rate: float = 30.0,
    window: float = 0.2,
    horizon: float = 0.5,
    label: Action = None,
    per_action: Switch = False,
    scene: SceneFile = None,
    seed: int = 0,
    format: FormatName = None,
    cluster: ClusterPlace = None,
) -> None:
    """Trains one method on recordings and writes it to a file, whole or not at all.

    Args:
        paths: recordings, or folders of them.
        out: the model file, ending in .npz.
        method: name of the method.
        rate: frames per second the model works at.
        window: how much is observed [s].
        horizon: how much is predicted [s].
        label: train only where the recordings' label is this action.
        per_action: beside the general model of the method kinecast, one for each action (label, or task where there are
            no labels), weighted online by how well each explains the last second.
        scene: obstacles, a YAML file; windows that end inside one are left out.
        seed: of everything random.
        format: read recordings as this format instead of finding it by content.
        cluster: spread the work over a Dask cluster that you trust: a scheduler's address, or N processes of this
            machine. The model is the same to the last bit.
    """
    check_names([method])
    check_seed(seed)
    if per_action and (method != "kinecast" or label is not None):
        raise OptionError("--per-action goes with the method kinecast, and without --label")
    check_file(out, (".npz",))
    options = WindowOptions(rate=rate, window=window, horizon=horizon, label=label)
    obstacles = None if scene is None else Scene.load(scene)
    recordings = read_recordings(paths, format)
    settings = TrainingOptions(seed=seed)
    with crew(cluster) as workers:
        with progress_bar("cutting windows") as progress:
            data = training_windows(recordings, options, obstacles, progress, workers)
        actions = training_windows_by_action(recordings, options, obstacles, workers) if per_action else {}
        with progress_bar(f"training {method}") as progress:
            trained = fit([method], data, settings, progress, workers)[method]
        if actions:
            with progress_bar("training a model per action") as progress:
                trained = with_actions(trained, actions, settings, progress, workers)
    names = [recording.name for recording in recordings]
    save_method(out, card_of(method, trained, data, settings, label or "", names), trained)
    print(f"{out}: {method}, trained on {len(data)} windows of {len(names)} recording{'s' * (len(names) != 1)}")
    if actions:
        print("  actions: " + ", ".join(f"{name} ({len(windows)})" for name, windows in actions.items()))
