"""Localization of a recording judged: truth, error, NEES, protection level, availability, pictures."""
