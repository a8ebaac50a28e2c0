"""Lightweight deep networks for stereo matching (MobileStereoNet)."""

import lazy_loader

__version__ = "0.2.0"

# The names of __init__.pyi, each loaded at its first use: `msnet --help` does not wait for torch.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
