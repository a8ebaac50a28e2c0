"""What test engines have in common; see `mobilestereonet.engines.base.Engine`."""

import torch


class FakeEngine:
    name = "fake"
    precision = "fp32"
    device = torch.device("cpu")
    threads = None
    size_multiple = 1
    min_side = 1
    max_disparity = 16
    has_confidence = False

    @staticmethod
    def preprocessing(view):
        return view
