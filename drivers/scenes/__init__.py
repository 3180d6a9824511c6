"""Worlds as linear radiance: geometry, textures, light, trajectories."""
