"""Recordings of generated people, clean and as measured."""

from __future__ import annotations

import numpy as np

from kinecast.datasets.recording import Recording
from kinecast.datasets.synthetic.activity import TASKS, Actor
from kinecast.datasets.synthetic.body import JOINTS, Body
from kinecast.datasets.synthetic.options import SyntheticOptions, table_scene
from kinecast.datasets.synthetic.sensor import sense

__all__ = ["generate", "generate_clean"]


def generate(options: SyntheticOptions, seed: int) -> list[Recording]:
    """People at a table as a tracker sees them: noise, jumps, dropouts, repeated frames, breathing bones.

    Args:
        options: how many, how long, how noisy.
        seed: the same seed gives the same recordings.

    Returns:
        `options.subjects` × `options.recordings` recordings with labels, subject and task; frame by frame the
        motions of `generate_clean` with the same options and seed.
    """
    return [sense(truth, options, np.random.default_rng(sensor)) for truth, sensor in _performances(options, seed)]


def generate_clean(options: SyntheticOptions, seed: int) -> list[Recording]:
    """The true motions behind `generate`: constant bones, no noise, nothing missing.

    Arms keep clear of the table, of their joints' limits and of impossible speeds.
    """
    return [truth for truth, _ in _performances(options, seed)]


def _performances(options: SyntheticOptions, seed: int) -> list[tuple[Recording, np.random.SeedSequence]]:
    """Each true recording, and the seed of its sensor."""
    scene = table_scene(options)
    stamps = np.arange(max(1, round(options.duration * options.rate))) / options.rate
    performances = []
    for subject, person in enumerate(np.random.SeedSequence(seed).spawn(options.subjects)):
        build, *takes = person.spawn(1 + options.recordings)
        body = Body.sample(np.random.default_rng(build))
        for take, source in enumerate(takes):
            motion, sensor = source.spawn(2)
            task = TASKS[take % len(TASKS)]
            actor = Actor(body, options, scene, np.random.default_rng(motion))
            actor.perform(task, options.duration)
            truth = Recording(
                name=f"synthetic/{task}/{subject}-{take}",
                joints=JOINTS,
                stamps=stamps,
                positions=actor.joints(stamps),
                rate=options.rate,
                subject=f"synthetic-{subject}",
                task=task,
                labels=actor.labels(stamps),
                notes=("generated",),
            )
            performances.append((truth, sensor))
    return performances
