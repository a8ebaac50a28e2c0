"""Inference engines: what runs networks, behind one protocol."""
