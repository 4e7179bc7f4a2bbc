"""Generated people at a table: used where no recording can be shipped, and where the truth must be known.

    scene = table_scene(options)                 the table, and the goals on it
    measured = generate(options, seed=0)         as a depth camera would see it
    truth = generate_clean(options, seed=0)      the same motion, frame by frame, without a sensor
    person = fetching(fetches, duration, seed=0)  somebody who reaches for chosen places at chosen times

options: what can be chosen. body: how a person is built and posed. paths: minimum-jerk paths. activity: what
people do, and when. fetching: chosen places at chosen times. sensor: what a tracker makes of it.
"""

from kinecast.datasets.synthetic.fetching import Fetch, fetching
from kinecast.datasets.synthetic.generator import generate, generate_clean
from kinecast.datasets.synthetic.options import SyntheticOptions, table_scene

__all__ = ["Fetch", "SyntheticOptions", "fetching", "generate", "generate_clean", "table_scene"]
