"""Errors that reach the user: each names the value and what to do."""


class HeadlandError(Exception):
    """Base of all errors that the command line shows as one line instead of a traceback."""


class ConfigError(HeadlandError):
    """A configuration file or value is wrong; raised at start."""


class FieldError(HeadlandError):
    """A field, site or mission cannot be worked; names the place."""


class WiringError(HeadlandError):
    """Nodes do not fit together: two writers, a read without a writer, too little time."""


class LogError(HeadlandError):
    """A log cannot be read or written."""
