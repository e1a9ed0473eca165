"""Strict configuration: base class, loader, and the machine, site and mission classes that several folders use."""
