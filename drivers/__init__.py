"""Cameras: simulated, and real ones through Aravis."""
