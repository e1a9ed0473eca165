"""Diagnosis: history of alarms, live topics, and the files of the runs."""
