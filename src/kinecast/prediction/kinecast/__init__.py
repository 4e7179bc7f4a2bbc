"""The project's own predictor: features, learned experts, memory, gate, spread, constraint, method, training."""
