"""Marks the tests that show a clause of docs/requirements.md; docs/safety.md lists them (`make docs`)."""

import pytest


def clause(*ids: str, rule: str | None = None) -> pytest.MarkDecorator:
    """The marker of a test that shows these clauses; `rule` names the only rule concerned, also without an id."""
    return pytest.mark.clause(*ids, rule=rule)
