"""Guided calibrations."""
