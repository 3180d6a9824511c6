"""Experiments over many drives: sweeps, bounds, reproductions."""
