"""Policies in Python that come with Noctule: examples to begin with (docs/extending.md)."""
