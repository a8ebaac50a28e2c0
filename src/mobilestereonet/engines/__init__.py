"""Engines that run a network, behind one protocol."""
