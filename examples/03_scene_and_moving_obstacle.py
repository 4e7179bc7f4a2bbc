"""A scene and a moving obstacle.

Obstacles come into a prediction in two ways, and they are not the same.

Shows: a scene as a constraint (the table: arms cannot be inside it, so such motions are rejected), and an obstacle as
a question (the robot: how likely is it that an arm touches it, where it will be at each predicted instant).
"""

from __future__ import annotations

import numpy as np

from kinecast import Box, Predictor, PredictorOptions, Scene
from kinecast.datasets.reaching import Fetch, fetching
from kinecast.geometry.shapes import MovingObstacle, Waypoints
from kinecast.pipeline import frames

TABLE = """
table: {height: 0.9, center: [0.55, 0.0], extent: [0.76, 1.6], thickness: 0.04}
"""


def main() -> None:
    scene = Scene.from_yaml(TABLE)
    options = PredictorOptions(samples=300)
    free, constrained = Predictor.shipped(options=options), Predictor.shipped(scene, options)

    # The robot's hand comes down to the table in front of the person, from one second to two.
    gripper = Box(center=np.array([0.45, -0.1, 1.4]), size=np.array([0.15, 0.15, 0.2]))
    robot = MovingObstacle(gripper, Waypoints(np.array([1.0, 2.0]), np.array([[0.45, -0.1, 1.4], [0.45, -0.1, 1.0]])))

    person = fetching([Fetch(0.8, np.array([0.45, -0.1, 0.98]))], duration=3.0, seed=8, rate=30.0)
    print("   t    inside the table: free  constrained   kept   P(touching the robot within 0.5 s)")
    for index, frame in enumerate(frames(person)):
        without, prediction = free.observe(frame), constrained.observe(frame)
        if index < 10 or index % 10:
            continue
        inside = [1.0 - scene.free(each.samples, each.times).mean() for each in (without, prediction)]
        kept = prediction.diagnostics["accepted_fraction"]
        print(
            f"{frame.stamp:5.2f} s {100 * inside[0]:21.1f} % {100 * inside[1]:10.1f} % {100 * kept:6.1f} % "
            f"{touching(prediction.samples, prediction.times, robot).max():20.3f}   {prediction.status.name}"
        )


def touching(samples: np.ndarray, times: np.ndarray, obstacle: MovingObstacle) -> np.ndarray:
    """(T,) share of motions in which an arm, 5 cm thick, touches a moving obstacle where it is at each instant.

    For an obstacle that stays, `prediction.probability_of_hitting(shape, radius=0.05)` is the same.
    """
    return 1.0 - Scene((obstacle,)).free(samples, times, limb_radius=0.05).mean(axis=0)


if __name__ == "__main__":
    main()
