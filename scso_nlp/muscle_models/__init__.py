"""Muscle models: from activation to tendon force, one file per model and per class of muscles."""
