"""Looks at what stands between this computer and its cameras; every finding says what to do."""
