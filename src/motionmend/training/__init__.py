"""Training: one loop for every network. `loop.train(settings, folder)` does it, `config.Settings` says how."""
