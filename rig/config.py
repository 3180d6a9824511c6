"""Typed values from the files that a user writes."""
