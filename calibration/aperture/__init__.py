"""Two lenses that let the same light through (thesis 5.1.1)."""
