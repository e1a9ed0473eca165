"""Drive view: what is shown of a page state, as texts and numbers; pure functions."""
