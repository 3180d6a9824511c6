"""Judging pictures by what they are for: inliers, statistics, the report."""
