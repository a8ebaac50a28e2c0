"""Lightweight deep networks for stereo matching (MobileStereoNet)."""

__version__ = "0.1.0"
