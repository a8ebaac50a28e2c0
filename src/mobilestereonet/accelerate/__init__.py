"""Exact accelerations: rewritings of the networks that keep their results."""
