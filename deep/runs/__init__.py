"""Run folders: configuration, versions, logs, checkpoints."""
