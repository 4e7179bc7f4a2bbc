"""What training minimises: distances for networks and gate, likelihood for the error model."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

from kinecast.prediction.descent import descend
from kinecast.prediction.kinecast.error_model import SCALES, ErrorModel, Errors, inverse_ceiling
from kinecast.prediction.kinecast.experts import TRIVIAL, FeatureScale, Networks, arm_views, time_basis
from kinecast.prediction.kinecast.weights import JOINT_TYPE, Gate, step_basis

WIDTH, DROPPED = 160, 0.4
"""Units of the networks' layers, and the share of them left out at random while training."""
BASIS = 8
"""Functions of time that a displacement is made of."""
LEAST_MOTION = 0.02
"""Added to a window's motion [m] where its error is weighed by it."""
GATE_STEPS, GATE_BATCH, GATE_DECAY = 1500, 192, 1e-2
"""Of the gate's descent."""
EXPERTS_DROPPED = 0.2
"""Share of the learned experts left out at random while the gate is fitted: none is to be relied on alone."""
ROUNDS = 3
"""Of robust regression of the log error."""
ERROR_STEPS, ERROR_BATCH, ERROR_DECAY = 1200, 512, 5e-3
"""Of the descent from there to the maximum likelihood of scale and common factor."""
FINEST = 1e-3
"""Errors below this are the luck of a resting tracker that repeats itself: they are not learned from [m]."""
TOGETHER = 0.8
"""Share of the likelihood that is of whole poses; the rest is of each joint for itself."""
REACHED = 0.999
"""Share of errors within the error model's reach."""
SMOOTH, SMOOTH_EVERY = 5, 4
"""Functions of time that a drawn motion's departure from the mean is made of; one for four steps if that is more."""
TAIL = 4.0
"""Degrees of freedom of the Student t under which shapes are found: heavy tails do not bend them."""
RANK = 60
"""Directions kept of the correlation between all steps and joints."""


def step_weights(steps: int) -> Float[np.ndarray, " T"]:
    """(T,) what the distance at each step counts, one over its time: far steps, much less certain, do not drown near
    ones. They sum to one."""
    weights = 1.0 / np.arange(1.0, steps + 1)
    return weights / weights.sum()


def fit_network(
    scale: FeatureScale,
    observed: Float[np.ndarray, "W N 6 3"],
    future: Float[np.ndarray, "W T 6 3"],
    steps: int,
    seed: int,
) -> Networks:
    """One multilayer perceptron beside a linear skip that starts from ridge.

    The loss is the mean distance of a window over the root of its motion: fast collections do not drown slow ones.
    """
    views, basis = arm_views(observed), time_basis(future.shape[1], min(BASIS, future.shape[1]))
    features, amplitude = scale.features(views), views.amplitude
    target = views.to_arms(future).reshape(len(features), -1, 9)
    scaled = np.linalg.pinv(basis).astype(target.dtype) @ target
    scaled = scaled.reshape(len(features), -1) / amplitude[:, None]
    inputs, outputs = features.shape[1], scaled.shape[1]
    seen, weight, rng = features[:, :-2], amplitude[:, None], np.random.default_rng(seed)
    moment = seen.T @ (seen * weight) + 1e-3 * len(seen) * weight.mean() * np.eye(inputs - 2)
    skip = np.linalg.solve(moment, seen.T @ (scaled * weight))

    def layer(before: int, after: int, gain: float) -> Float[np.ndarray, "A B"]:
        return rng.normal(0.0, gain / np.sqrt(before), (before, after))

    start = [
        layer(inputs, WIDTH, 1.0), np.zeros((1, WIDTH)), layer(WIDTH, WIDTH, 1.0), np.zeros((1, WIDTH)),
        layer(WIDTH, outputs, 0.1), np.zeros((1, outputs)), skip,
    ]  # fmt: skip
    fitted = descend(
        _network_loss(basis), start, (features, amplitude, target),
        steps=steps, batch=256, rate=2e-3, decay=1e-3, second=0.999, seed=seed,
    )  # fmt: skip
    return Networks(scale, *(array[None].astype(Networks.PRECISION) for array in fitted))


def _network_loss(basis: Float[np.ndarray, "T K"]):  # type: ignore[no-untyped-def]
    weights = step_weights(len(basis))

    def loss(jax, parameters, rows, key):  # type: ignore[no-untyped-def]
        W1, b1, W2, b2, W3, b3, A = parameters
        x, amplitude, target = rows
        first, other = jax.random.split(key)

        def dropped(h: Any, key: Any) -> Any:
            return h * jax.random.bernoulli(key, 1.0 - DROPPED, h.shape) / (1.0 - DROPPED)

        def size(e: Any) -> Any:
            distance = jax.numpy.sqrt((e.reshape(*e.shape[:2], 3, 3) ** 2).sum(-1) + 1e-6).mean(2)
            return distance @ weights

        h = dropped(jax.nn.silu(x @ W1 + b1), first)
        h = h + dropped(jax.nn.silu(h @ W2 + b2), other)
        coefficients = (h @ W3 + b3 + x[:, : A.shape[0]] @ A).reshape(len(x), -1, 9)
        error = jax.numpy.einsum("tk,bkc->btc", basis, coefficients) * amplitude[:, None, None] - target
        return 3.0 * (size(error) / jax.numpy.sqrt(size(target) + LEAST_MOTION)).mean()

    return loss


def fit_gate(
    errors: Float[np.ndarray, "B E 6 Q"],
    windows: Float[np.ndarray, "B 6 5"],
    forecasts: Float[np.ndarray, "B E K 6 3"],
    futures: Float[np.ndarray, "B K 6 3"],
    steps: int,
    at: slice,
    seed: int,
) -> Gate:
    """The gate with the least mean distance of the mixture, windows weighted by one over the root of their motion.

    `errors` and `windows` are its inputs; what experts forecast and what came, at the K steps `at` of T, are relative
    to the last pose [m].
    """
    experts, sources = forecasts.shape[1], errors.shape[-1]
    basis = step_basis(steps)[at]

    def loss(jax, parameters, rows, key):  # type: ignore[no-untyped-def]
        jnp = jax.numpy
        bias, share, slope = parameters
        error, look, made, came = rows
        logits = (bias @ basis.T)[:, JOINT_TYPE][None]
        logits = logits - (error @ share) @ basis.T
        logits = logits + jnp.einsum("bjg,egk->bejk", look, slope) @ basis.T
        kept = jax.random.bernoulli(key, 1.0 - EXPERTS_DROPPED, error.shape[:2]) | (jnp.arange(experts) < TRIVIAL)
        logits = jnp.where(kept[:, :, None, None], logits, -1e9)
        weights = jax.nn.softmax(logits, axis=1).transpose(0, 1, 3, 2)
        mixed = (weights[..., None] * made).sum(axis=1)
        distance = jnp.sqrt(((mixed - came) ** 2).sum(-1) + 1e-7)
        motion = jnp.sqrt((came**2).sum(-1)).mean((1, 2)) + LEAST_MOTION
        penalty = GATE_DECAY * ((bias**2).sum() + (slope**2).sum())
        return 3.0 * (distance.mean((1, 2)) / jnp.sqrt(motion)).mean() + penalty

    share = np.zeros((sources, 3))
    share[:, 0] = 5.0 / sources
    start = [np.zeros((experts, 3, 3)), share, np.zeros((experts, 5, 3))]
    bias, share, slope = descend(
        loss, start, (errors, windows, forecasts, futures),
        steps=GATE_STEPS, batch=GATE_BATCH, rate=0.02, decay=0.0, second=0.99, seed=seed,
    )  # fmt: skip
    return Gate(bias, share, slope)


def fit_error_model(errors: Errors, features: Float[np.ndarray, "B 6 F"], seed: int = 0) -> ErrorModel:
    """The error model of errors that recordings left out of training had.

    Args:
        errors: (B, T, 6, 3) truth minus mean in each arm's own axes (right arm in a mirror) [m].
        features: (B, 6, F) of `error_features`.
        seed: of the descent.
    """
    steps = errors.shape[1]
    slope, shape = np.empty((3, steps, features.shape[2])), np.empty((3, steps, 3, 3))
    unit = np.empty(errors.shape, np.float32)
    for kind in range(3):
        joints = np.flatnonzero(kind == JOINT_TYPE)
        table = features[:, joints].reshape(-1, features.shape[2])
        own = errors[:, :, joints].transpose(0, 2, 1, 3).reshape(-1, steps, 3).astype(float)
        slope[kind] = _log_scale(table, np.log(np.linalg.norm(own, axis=-1) + 1e-4))
        scaled = own / np.exp(table @ slope[kind].T)[..., None]
        for t in range(steps):
            shape[kind, t] = np.linalg.cholesky(_shape(scaled[:, t]))
            solved = np.linalg.solve(shape[kind, t], own[:, t].T).T
            unit[:, t, joints] = solved.reshape(len(errors), len(joints), 3)
    sizes = np.linalg.norm(errors, axis=-1)
    reach = np.stack([np.quantile(sizes[:, :, kind == JOINT_TYPE], REACHED, axis=(0, 2)) for kind in range(3)])
    reach = np.maximum(reach.astype(float), FINEST)
    least = inverse_ceiling(reach, shape)
    slope, tail = _most_likely(slope, least, unit, features, seed)
    inverse = np.exp(-np.einsum("jtf,bjf->btj", slope[JOINT_TYPE], features)) + least[JOINT_TYPE].T
    return ErrorModel(slope, reach, shape, *_correlation(unit * inverse[..., None]), tail)


def _most_likely(
    slope: Float[np.ndarray, "3 T F"],
    inverse_ceiling: Float[np.ndarray, "3 T"],
    unit: Errors,
    features: Float[np.ndarray, "B 6 F"],
    seed: int,
) -> tuple[Float[np.ndarray, "3 T F"], Float[np.ndarray, "F K"]]:
    """Scales and common factors of maximum likelihood, of joints and of whole poses, each step for itself.

    Added to the scale is what varies smoothly with the step; `unit` are errors over their shape [m].
    """
    steps, basis = unit.shape[1], step_basis(unit.shape[1])
    white = unit / np.exp(np.einsum("jtf,bjf->btj", slope[JOINT_TYPE], features))[..., None]
    poses = _alike(white).reshape(len(unit), steps, 18)
    covariance = np.einsum("bti,btj->tij", poses, poses, optimize=True) / len(poses)
    spread = np.sqrt(np.einsum("tii->ti", covariance))
    correlation = covariance / spread[:, :, None] / spread[:, None] + FINEST * np.eye(18)
    decorrelate = np.linalg.inv(np.linalg.cholesky(correlation))

    def loss(jax, parameters, rows, _key):  # type: ignore[no-untyped-def]
        jnp = jax.numpy
        more, tail = parameters
        unit, look = rows
        slopes = slope + jnp.einsum("jkf,tk->jtf", more, basis)
        log_scale = -jnp.einsum("jtf,bjf->btj", slopes[JOINT_TYPE], look)
        log_scale = -jnp.logaddexp(log_scale, np.log(inverse_ceiling[JOINT_TYPE].T))
        log_weights = jax.nn.log_softmax(look.mean(axis=1) @ tail)[:, None]
        z = unit * jnp.exp(-log_scale)[..., None]
        least = FINEST**2 * jnp.exp(-2.0 * log_scale)
        joint = ((z**2).sum(-1) + least)[..., None] / SCALES**2
        joint = jax.nn.logsumexp(log_weights[:, None] - 0.5 * joint - 3.0 * jnp.log(SCALES), axis=-1)
        pose = jnp.einsum("tij,btj->bti", decorrelate, z.reshape(-1, steps, 18))
        pose = ((pose**2).sum(-1) + least.sum(-1))[..., None] / SCALES**2
        pose = jax.nn.logsumexp(log_weights - 0.5 * pose - 18.0 * jnp.log(SCALES), axis=-1)
        likelihood = (1.0 - TOGETHER) * joint.mean() + TOGETHER * pose.mean() / 6.0 - 3.0 * log_scale.mean()
        return -likelihood + ERROR_DECAY * ((more**2).sum() + (tail**2).sum())

    start = [np.zeros((3, basis.shape[1], features.shape[2])), np.zeros((features.shape[2], len(SCALES)))]
    more, tail = descend(
        loss, start, (unit, features),
        steps=ERROR_STEPS, batch=ERROR_BATCH, rate=0.02, decay=0.0, second=0.99, seed=seed,
    )  # fmt: skip
    return slope + np.einsum("jkf,tk->jtf", more, basis), tail


def _log_scale(table: Float[np.ndarray, "B F"], target: Float[np.ndarray, "B T"]) -> Float[np.ndarray, "T F"]:
    """Robust linear regression of the log error, each step for itself."""
    ridge = 1e-3 * len(table) * np.eye(table.shape[1])
    slope = np.linalg.solve(table.T @ table + ridge, table.T @ target).T
    for _ in range(ROUNDS):
        for t in range(target.shape[1]):
            weight = 1.0 / (1.0 + ((target[:, t] - table @ slope[t]) / 1.5) ** 2)
            weighted = table * weight[:, None]
            slope[t] = np.linalg.solve(weighted.T @ table + ridge, weighted.T @ target[:, t])
    return slope


def _shape(unit: Float[np.ndarray, "B 3"]) -> Float[np.ndarray, "3 3"]:
    """Scatter of a Student t about zero (fixed-point iteration of maximum likelihood)."""
    scatter = np.eye(3)
    for _ in range(8):
        square = np.einsum("bi,ij,bj->b", unit, np.linalg.inv(scatter), unit)
        scatter = ((TAIL + 3.0) / (TAIL + square))[:, None] * unit
        scatter = scatter.T @ unit / len(unit) + 1e-9 * np.eye(3)
    return scatter


def _correlation(white: Errors) -> tuple[Float[np.ndarray, "T 6 3 R"], Float[np.ndarray, "T 6 3"]]:
    """Leading directions of the correlation, smooth in time, at unit spread of each number, and what they leave out.

    What is not smooth is the sensor's noise, not the person's motion.
    """
    steps = white.shape[1]
    white = _alike(white)
    early = np.sqrt(np.arange(1.0, steps + 1) / steps)  # errors change most in the first steps
    functions = np.arange(min(max(SMOOTH, steps // SMOOTH_EVERY), steps))
    smooth = np.linalg.qr(np.cos(np.pi * np.outer(early, functions)))[0]
    flat = np.einsum("tk,sk,bsjd->btjd", smooth, smooth, white, optimize=True).reshape(len(white), -1)
    spread = np.sqrt((white**2).mean(axis=0)).ravel()
    values, vectors = np.linalg.eigh(flat.T @ flat / len(flat) / np.outer(spread, spread))
    kept = min(RANK, len(values))
    factor = vectors[:, -kept:] * np.sqrt(np.maximum(values[-kept:], 0.0))
    held = np.linalg.norm(factor, axis=1, keepdims=True)
    rough = np.sqrt(np.maximum(1.0 - held**2, 0.0))
    return (factor / held).reshape(*white.shape[1:], kept), rough.reshape(white.shape[1:])


def _alike(white: Errors) -> Errors:
    """Every example at unit spread, however large its error: its common factor is divided out."""
    return white / np.sqrt((white**2).mean(axis=(1, 2, 3), keepdims=True) + 1e-9)
