"""A simulated pair of cameras on a virtual clock."""
