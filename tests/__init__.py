"""Tests, by folder of the code they test."""
