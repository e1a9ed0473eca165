"""Sensor models, one file per kind: topic, period and `sample(state)`."""
