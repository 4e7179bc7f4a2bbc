"""The horizon model with one stage switched off at a time: what each of them is worth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from kinecast.prediction.kinecast.gate import TRIVIAL
from kinecast.prediction.kinecast.learned import Network
from kinecast.prediction.kinecast.method import Horizon, Mixture

__all__ = ["ablations"]


def ablations(whole: Horizon) -> dict[str, Horizon]:
    """The model without each of its stages in turn, by what is missing."""
    mixture, spread = whole.mixture, whole.spread
    learned = range(len(mixture.experts))
    networks = [k for k in learned if isinstance(mixture.experts[k], Network)]
    others = [k for k in learned if k not in networks]
    return {
        "no network": replace(whole, mixture=_without(mixture, networks)),
        "no radial basis": replace(whole, mixture=_without(mixture, others)),
        "no gate": replace(whole, mixture=replace(mixture, gate=None)),
        "no guard": replace(whole, mixture=replace(mixture, guarded=False)),
        "no following": replace(whole, following=False),
        "no adaptive spread": replace(whole, adaptive=False),
        "no conformal correction": replace(whole, spread=replace(spread, conformal=np.ones_like(spread.conformal))),
        "no limits, no scene": replace(whole, limits=None),
    }


def _without(mixture: Mixture, dropped: Sequence[int]) -> Mixture:
    """The mixture without some of its learned experts; the gate keeps what it learned of the others."""
    experts = [expert for k, expert in enumerate(mixture.experts) if k not in dropped]
    rows = [k for k in range(TRIVIAL + len(mixture.experts)) if k - TRIVIAL not in dropped]
    gate = mixture.gate
    if gate is not None:
        gate = replace(gate, bias=gate.bias[rows], slope=gate.slope[rows])
    return replace(mixture, experts=experts, gate=gate)
