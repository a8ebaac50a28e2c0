"""Quantisation to int8 after training, by NNCF."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from mobilestereonet.engines.openvino import without_telemetry
from mobilestereonet.export.base import INPUTS, Pair


def float_nodes(nodes: Sequence[tuple[str, str]], upsampling: str, convolution: str) -> list[str]:
    """Names of the nodes that stay in float: from the scores that the soft-argmax reads on.

    Without an upsampling it is the last convolution on.

    Args:
        nodes: Name and type of each node, in the order in which they run.
        upsampling: Type of the node that upsamples the scores.
        convolution: Type of a convolution.
    """
    types = [kind for _, kind in nodes]
    upsamplings = [index for index, kind in enumerate(types) if kind == upsampling]
    last_upsampling = upsamplings[-1] if upsamplings else len(types)
    last_convolution = max(i for i in range(last_upsampling) if types[i] == convolution)
    return [name for name, _ in nodes[last_convolution:]]


def quantise(model: Any, pairs: Sequence[Pair], keep: Sequence[str]) -> Any:
    """Quantise weights and activations to int8.

    Args:
        model: What NNCF takes: an ONNX or an OpenVINO model.
        pairs: Calibration pairs.
        keep: Names of the nodes that stay in float, see `float_nodes`.

    Returns:
        The quantised model.
    """

    def feed(pair: Pair) -> Mapping[str, Any]:
        return {name: view.numpy() for name, view in zip(INPUTS, pair, strict=True)}

    with without_telemetry():
        import nncf  # which keeps what it finds

        return nncf.quantize(
            model,
            nncf.Dataset(list(pairs), feed),
            subset_size=len(pairs),
            preset=nncf.QuantizationPreset.MIXED,
            ignored_scope=nncf.IgnoredScope(names=list(keep)),
        )
