"""Real cameras through Aravis. Only `binding` in this folder knows the library itself."""
