"""Evaluation of logs: measures, verdicts by clause and reports; runs no part of the stack."""
