"""USB3 Vision cameras without a bus: Aravis' own USB code runs over them. Used by tests only."""
