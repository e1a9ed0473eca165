"""Strict configuration: the base class, the loader, and what more than one folder must know of machine and site."""
