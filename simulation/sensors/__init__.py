"""Sensor models, one file each: a period, a topic and `sample(moment)`."""
