"""From recordings to a network: dataset, targets, training, export."""
