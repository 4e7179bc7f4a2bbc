"""Goals.

A scene that names the places a hand may head for gives predictions with a hump for each, and says how likely it is.

Shows: goals in a scene, the probability of each for either hand, how it moves while somebody reaches for one place and
then for the other, and what it changes in where the wrist is expected half a second from now.
"""

from __future__ import annotations

import numpy as np

from kinecast import Predictor, PredictorOptions, Scene
from kinecast.datasets.reaching import Fetch, fetching
from kinecast.pipeline import frames

SCENE = """
table: {height: 0.9, center: [0.55, 0.0], extent: [0.76, 1.6], thickness: 0.04}
goals:
  screws: {center: [0.45, -0.05, 1.0], radius: 0.05}
  tray: {center: [0.35, -0.42, 1.0], size: [0.14, 0.2, 0.04]}
"""


def main() -> None:
    scene = Scene.from_yaml(SCENE)
    places = {name: shape.center for name, shape in scene.goals.items()}
    person = fetching(
        [Fetch(1.0, places["screws"], hold=0.2, left=False), Fetch(2.9, places["tray"], hold=0.2, left=False)],
        duration=4.4,
        seed=4,
        rate=30.0,
    )
    options = PredictorOptions(samples=300)
    informed = Predictor.shipped(scene, options)
    without = Predictor.shipped(Scene(scene.obstacles), options)  # the same table, no goals: as if there were none

    wrist = person.joint("right_wrist")
    print("   t    right hand heads for: screws  tray  none    wrist in 0.5 s, error: with goals  without")
    for index, frame in enumerate(frames(person)):
        prediction, other = informed.observe(frame), without.observe(frame)
        if index < 24 or index % 6 or index + 15 >= len(wrist):
            continue
        error = [1e3 * np.linalg.norm(each.mean[-1, 5] - wrist[index + 15]) for each in (prediction, other)]
        shares = "  ".join(f"{100 * share:3.0f}" for share in prediction.goals["right"].values())
        print(f"{frame.stamp:5.2f} s {'':22}{shares} % {'':26}{error[0]:4.0f} mm  {error[1]:4.0f} mm")


if __name__ == "__main__":
    main()
