"""The live page: a watcher that never holds up what it watches."""
