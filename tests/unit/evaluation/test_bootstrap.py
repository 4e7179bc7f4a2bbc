"""Standard errors against closed forms: independent windows, windows that remember, many recordings."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from kinecast.evaluation.metrics import block_bootstrap

# A standard deviation from n draws is itself known to 1 / √(2 n) of its value.
OF_1000_DRAWS = 4 / np.sqrt(2000)


def alone(windows: int) -> np.ndarray:
    """The owner of the windows of a single recording."""
    return np.zeros(windows, dtype=np.int64)


def autoregression(rng: np.random.Generator, windows: int, memory: float) -> np.ndarray:
    """x_t = memory x_{t−1} + noise of standard deviation one, begun in its long-run law."""
    noise = rng.standard_normal(windows)
    noise[0] /= np.sqrt(1 - memory**2)
    return lfilter([1.0], [1.0, -memory], noise)


def test_independent_windows() -> None:
    scores = np.random.default_rng(1).standard_normal(4000)
    assert block_bootstrap(scores, alone(4000), block=1) == pytest.approx(
        scores.std() / np.sqrt(4000), rel=OF_1000_DRAWS
    )


def test_windows_that_remember_need_blocks() -> None:
    """An autoregression has standard error 1 / ((1 − memory) √n): three times what single windows tell."""
    rng = np.random.default_rng(2)
    exact = 1 / (0.2 * np.sqrt(3000))
    series = [autoregression(rng, 3000, 0.8) for _ in range(10)]
    errors = [block_bootstrap(scores, alone(3000), block=60) for scores in series]
    singly = [block_bootstrap(scores, alone(3000), block=1) for scores in series[:3]]
    # Blocks of 60 lose 2 · 0.8 / (60 · (1 − 0.8²)) = 7 % of the variance, 3.5 % of its root.
    tolerance = 0.035 + 4 * np.std(errors) / np.mean(errors) / np.sqrt(10)
    assert np.mean(errors) == pytest.approx(exact, rel=tolerance)
    assert np.mean(singly) == pytest.approx(exact / 3, rel=0.1)


def test_recordings_are_drawn_whole() -> None:
    """Twelve recordings that differ far more than their windows do: only the recordings count."""
    rng = np.random.default_rng(3)
    levels = rng.standard_normal(12)
    scores = np.repeat(levels, 100) + 0.01 * rng.standard_normal(1200)
    stderr = block_bootstrap(scores, np.repeat(np.arange(12), 100), block=30)
    assert stderr == pytest.approx(levels.std(ddof=1) / np.sqrt(12), rel=OF_1000_DRAWS + 0.01)


def test_the_seed_decides() -> None:
    scores = np.random.default_rng(4).standard_normal(50)
    first, again, other = (block_bootstrap(scores, alone(50), block=5, seed=seed) for seed in (7, 7, 8))
    assert first == again
    assert first != other


def test_windows_without_a_score_do_not_count() -> None:
    rng = np.random.default_rng(5)
    scores = rng.standard_normal(3000)
    scores[rng.random(3000) < 0.3] = np.nan
    kept = scores[np.isfinite(scores)]
    owner = np.repeat([0, 1], [3000, 40])
    padded = np.concatenate([scores, np.full(40, np.nan)])
    stderr = block_bootstrap(padded, owner, block=5)
    # Blocks of 5 independent windows: their spread is that of 600 sums, so a little looser.
    assert stderr == pytest.approx(kept.std() / np.sqrt(len(kept)), rel=OF_1000_DRAWS + 0.1)
    padded[-1] = 0.0
    assert np.isfinite(block_bootstrap(padded, owner, block=30))


@pytest.mark.parametrize("scores", [np.zeros(0), np.full(5, np.nan), np.array([np.nan, 2.0])])
def test_less_than_two_windows_have_no_error(scores: np.ndarray) -> None:
    assert np.isnan(block_bootstrap(scores, alone(len(scores)), block=30))


def test_a_block_longer_than_the_recording_still_varies() -> None:
    assert block_bootstrap(np.arange(12.0), alone(12), block=500) > 0
