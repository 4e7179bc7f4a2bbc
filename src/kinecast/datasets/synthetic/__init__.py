"""Generated people at a table: used where no recording can be shipped, and where the truth must be known.

generator: what can be chosen, the scene, and what a tracker makes of the people. physique: how a person is built and
posed. activity: what people do, when, and on which paths.
"""

from kinecast.datasets.synthetic.generator import (
    Fetch,
    SyntheticOptions,
    fetching,
    generate,
    generate_clean,
    table_scene,
)

__all__ = ["Fetch", "SyntheticOptions", "fetching", "generate", "generate_clean", "table_scene"]
