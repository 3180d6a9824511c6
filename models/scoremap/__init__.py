"""Score maps: networks that say of every setting how good it is next, and their lessons."""
