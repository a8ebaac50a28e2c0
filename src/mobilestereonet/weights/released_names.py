"""Names of tensors in the authors' released checkpoints, from ours: one function per network."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from mobilestereonet.nets import model_info
from mobilestereonet.weights.names import substituted

_PREFIXES = (
    (r"features\.first\.(\d)\.0\.", "feature_extraction.firstconv.{0}."),
    (r"features\.stage(\d)\.", "feature_extraction.layer{0}."),
    (r"reduction\.(\d)\.", "preconv11.{0}."),
    (r"volume\.conv\.(\d)\.", "conv3d.{0}."),
    (r"volume\.norm\.(\d)\.", "conv3d.{0}."),
    (r"volume\.squeeze\.", "volume11.0."),
    (r"pre_hourglass\.first\.(\d)\.0\.", "dres0.{0}."),
    (r"pre_hourglass\.second\.(\d)\.0\.", "dres1.{0}."),
    (r"hourglasses\.(\d)\.(?:conv|up)(\d)\.", "encoder_decoder{0}.conv{1}."),
    (r"hourglasses\.(\d)\.redirect(\d)\.", "encoder_decoder{0}.redir{1}."),
    (r"heads\.(\d)\.conv\.", "classif{0}.0."),
    (r"heads\.(\d)\.score\.", "classif{0}.2."),
)


def authors_key(key: str, config: Any) -> str:
    """MobileStereoNet's authors' name for a name in our state dict, for networks of v2 blocks.

    Args:
        key: Our name.
        config: Config of the network.
    """
    # Their indices count the activations between the layers, ours don't.
    relu = 2 if config.v2_relu else 1
    scale = {"firstconv": relu, "dres0": relu, "dres1": relu, "preconv11": 2, "conv3d": 3}
    for pattern, template in _PREFIXES:
        match = re.match(pattern, key)
        if match is None:
            continue
        name = next((name for name in scale if name in template), "")
        first, *others = (int(group) for group in match.groups() or ("0",))
        first = first * scale.get(name, 1) + (
            "norm" in pattern or template.startswith("encoder_decoder")
        )
        return template.format(first, *others) + key[match.end() :]
    raise AssertionError(f"no rule for {key}")


_Rule = tuple[str, str | Callable[[re.Match[str]], str]]
"""A pattern in our name, and what takes its place, as `re.sub` has it."""


def _number(template: str, factor: int = 1, offset: int = 0) -> Callable[[re.Match[str]], str]:
    """Replacement by a template, in which a linear function of the matched number is put."""
    return lambda match: template.format(factor * int(match[1]) + offset)


def _hourglass_networks(nested: str, first_head: int) -> tuple[_Rule, ...]:
    """What the releases of `psmnet` and of `gwcnet-g` have in common.

    Args:
        nested: Numbers of an hourglass's convolutions that are one level deeper, for the ReLU.
        first_head: Number of the first head.
    """
    return (
        (r"\.first\.(\d)", _number(".firstconv.{}", 2)),
        (r"\.stage(\d)", r".layer\1"),
        (r"(layer\d\.\d+\.conv1)\.", r"\1.0."),
        (r"^pre_hourglass\.firstconv\.(\d)", r"dres0.\1"),
        (r"^pre_hourglass\.second\.(\d)", _number("dres1.{}", 2)),
        (r"^hourglasses\.(\d)", _number("dres{}", 1, 2)),
        (rf"(dres\d\.conv[{nested}])\.", r"\1.0."),
        (r"\.up(\d)\.", r".conv\1."),
        (r"\.redirect(\d)\.", r".redir\1."),
        (r"^heads\.(\d)", _number("classif{}", 1, first_head)),
        (r"^(classif\w+)\.conv\.", r"\1.0."),
        (r"^(classif\w+)\.score\.", r"\1.2."),
    )


_PSMNET: tuple[_Rule, ...] = (
    (r"^features\.trunk\.", "feature_extraction."),
    (r"^features\.branches\.(\d)", _number("feature_extraction.branch{}.1", -1, 4)),
    (r"^features\.fusion\.(\d)", _number("feature_extraction.lastconv.{}", 2)),
    (r"^blocks\.(\d)\.0", _number("dres{}.0", 1, 2)),
    (r"^blocks\.(\d)\.1", _number("dres{}.2", 1, 2)),
    (r"^head\.", "classify."),
    *_hourglass_networks("134", first_head=1),
)
_GWCNET: tuple[_Rule, ...] = (
    (r"^features\.", "feature_extraction."),
    (r"^reduction\.(\d)", _number("feature_extraction.lastconv.{}", 2)),
    *_hourglass_networks("1234", first_head=0),
)
_GCNET: tuple[_Rule, ...] = (
    (r"^features\.first\.0", "conv0"),
    (r"^features\.first\.1", "bn0"),
    (r"^features\.blocks\.(\d)\.first\.0", r"res_block.\1.conv1"),
    (r"^features\.blocks\.(\d)\.first\.1", r"res_block.\1.bn1"),
    (r"^features\.blocks\.(\d)\.second\.0", r"res_block.\1.conv2"),
    (r"^features\.blocks\.(\d)\.second\.1", r"res_block.\1.bn2"),
    (r"^features\.last", "conv1"),
    (r"^skips\.0\.(\d)\.0", _number("conv3d_{}", 1, 1)),
    (r"^skips\.0\.(\d)\.1", _number("bn3d_{}", 1, 1)),
    (r"^down\.(\d)\.0\.0", _number("conv3d_{}", 1, 3)),
    (r"^down\.(\d)\.0\.1", _number("bn3d_{}", 1, 3)),
    (r"^bottom\.", "skips.4."),
    (r"^(skips\.\d)\.(\d)\.0", lambda match: f"{match[1]}.0.conv{int(match[2]) + 1}"),
    (r"^(skips\.\d)\.(\d)\.1", lambda match: f"{match[1]}.0.bn{int(match[2]) + 1}"),
    (r"^skips\.(\d)", r"block_3d_\1"),
    (r"^up\.(\d)\.0", _number("deconv{}", 1, 1)),
    (r"^up\.(\d)\.1", _number("debn{}", 1, 1)),
    (r"^cost\.", "deconv5."),
)
_GANET: tuple[_Rule, ...] = (
    (r"^guidance\.image\.", "conv_start."),
    (r"^guidance\.features\.", "conv_refine."),
    (r"^guidance\.features_norm\.", "bn_relu."),
    (r"^left\.", "conv_x."),
    (r"^right\.", "conv_y."),
    (r"^features\.start\.", "feature.conv_start."),
    (r"^features\.down([12])\.(\d)", lambda m: f"feature.conv{int(m[2]) + 1}{' ab'[int(m[1])]}"),
    (r"^features\.up([12])\.(\d)", lambda m: f"feature.deconv{4 - int(m[2])}{' ab'[int(m[1])]}"),
    (r"^guidance\.start\.", "guidance.conv0."),
    (r"^guidance\.local\.(\d)", _number("guidance.weight_lg{}", 1, 1)),
    (r"^guidance\.steps3\.(\d)", _number("guidance.conv{}", 1, 1)),
    (r"^guidance\.steps6\.(\d)", _number("guidance.conv{}", 1, 11)),
    (r"^guidance\.weights3\.(\d)", _number("guidance.weight_sg{}", 1, 1)),
    (r"^guidance\.weights6\.(\d)", _number("guidance.weight_sg{}", 1, 11)),
    (r"^start\.", "cost_agg.conv_start."),
    (r"^guided\.", "cost_agg.sga1."),
    (r"^passes\.(\d)\.guided_down", _number("cost_agg.sga{}", 2, 11)),
    (r"^passes\.(\d)\.guided_up", _number("cost_agg.sga{}", 2, 12)),
    (r"^passes\.(\d)\.guided", _number("cost_agg.sga{}", 1, 2)),
    (r"^passes\.(\d)\.down(\d)", lambda m: f"cost_agg.conv{m[2]}{'ab'[int(m[1])]}"),
    (r"^passes\.(\d)\.up(\d)", lambda m: f"cost_agg.deconv{m[2]}{'ab'[int(m[1])]}"),
    (r"(sga\d+)\.norm\.", r"\1.bn_relu."),
    (r"(sga\d+)\.conv\.", r"\1.conv_refine."),
    (r"\.resize\.", ".conv1."),
    (r"\.join\.", ".conv2."),
    (r"^heads\.(\d)\.cost", r"cost_agg.disp\1.conv32x1"),
    (r"(?<!bn_relu)\.0\.(\w+)$", r".conv.\1"),
    (r"(?<!weight_lg\d)\.1\.(\w+)$", r".bn.\1"),
)
_DEEPPRUNER: tuple[_Rule, ...] = (
    (r"^features\.trunk\.first", "feature_extraction.firstconv"),
    (r"^features\.trunk\.stage", "feature_extraction.layer"),
    (r"^features\.branches\.(\d)", _number("feature_extraction.branch{}.1", -1, 4)),
    (r"^features\.fusion", "feature_extraction.lastconv"),
    (r"^aggregate\.0", "cost_aggregator.reduce"),
    (r"^aggregate\.1", "cost_aggregator"),
    (r"(^|\.)reduce\.(\d)", lambda m: f"{m[1]}dres{int(m[2]) // 2}.{int(m[2]) % 2}"),
    (r"^lower\.", "min_disparity."),
    (r"^upper\.", "max_disparity."),
    (r"\.hourglass\.", "_predictor."),
    (r"^smoothing\.disparity", "ca_disparity_conv"),
    (r"^smoothing\.scores", "ca_features_conv"),
    (r"\.smoothing\.disparity", "_conv"),
    (r"\.smoothing\.scores", "_features_conv"),
    (r"\.down\.(\d)", lambda m: (".conv1", ".conv1_1", ".conv3")[int(m[1])]),
    (r"\.same\.(\d)", lambda m: (".conv2", ".conv2_1", ".conv4")[int(m[1])]),
    (r"\.up\.(\d)", _number(".conv{}", 1, 5)),
    (r"\.score\.", ".last_conv3d_layer."),
    (r"^refinements\.0", "refinement_net"),
    (r"^refinements\.1", "refinement_net1"),
    (r"\.convs\.", ".conv1."),
    (r"\.residual\.", ".classif1."),
)


_RULES: dict[str, tuple[_Rule, ...]] = {
    "psmnet": _PSMNET,
    "psmnet-basic": _PSMNET,
    "gwcnet-g": _GWCNET,
    "gwcnet-gc": _GWCNET,
    "gwcnet-gc-base": _GWCNET,
    "gcnet": _GCNET,
    "ganet-11": _GANET,
    "ganet-deep": _GANET,
    "deeppruner-best": _DEEPPRUNER,
    "deeppruner-fast": _DEEPPRUNER,
}
MARKS = {
    "msnet2d": "feature_extraction.",
    "msnet3d-authors": "feature_extraction.",
    **dict.fromkeys(("psmnet", "psmnet-basic"), "feature_extraction."),
    **dict.fromkeys(("gwcnet-g", "gwcnet-gc", "gwcnet-gc-base"), "feature_extraction."),
    "gcnet": "res_block.",
    **dict.fromkeys(("ganet-11", "ganet-deep"), "cost_agg."),
    **dict.fromkeys(("deeppruner-best", "deeppruner-fast"), "cost_aggregator."),
}
"""By network, what names in its released checkpoints hold and ours never do."""


def released_name(network: str, name: str) -> str:
    """What a released checkpoint calls a tensor.

    Args:
        network: Registered name of the network, one of `MARKS`.
        name: Our name of the tensor.
    """
    if network not in _RULES:
        return authors_key(name, model_info(network).config)
    return substituted(name, _RULES[network])
