"""Pure functions on pictures: colour, features, matches, metrics."""
