"""Two cameras, two exposure controls, one fair comparison."""
