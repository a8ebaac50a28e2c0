"""The checkpoints of "Reversing the cycle" (Aleotti et al., ECCV 2020): its iResNet."""

from __future__ import annotations

import torch
from torch import Tensor

from mobilestereonet.errors import InputError
from mobilestereonet.weights.files import WeightsFile
from mobilestereonet.weights.names import Rule, translated_name
from mobilestereonet.weights.shapes import registered_shapes

MODEL = "iresnet-reversing"
_MARK = "disparity_refinement.r_"
_STEM, _STAGE, _REFINEMENT = "stem_block", "disparity_estimation", "disparity_refinement"

_RULES: list[Rule] = [
    (r"stage\.conv([12])\.0", lambda i: f"{_STEM}.conv{i}.0.0"),
    (r"multi_scale\.up(\d)\.0", lambda i: f"{_STEM}.up_{i}.0"),
    (r"project\.0", lambda: f"{_STEM}.up_12.0.0"),
    (r"stage\.redirect\.0", lambda: f"{_STAGE}.conv_redir.0.0"),
    (r"stage\.conv(\d)\.(\d)\.0", lambda i, k: f"{_STAGE}.conv{i}_1.{2 * k}.0"),
    (r"stage\.predict6", lambda: f"{_STAGE}.disp6.0.0"),
    (r"stage\.levels\.(\d)\.up\.0", lambda i: f"{_STAGE}.uconv{5 - i}.0"),
    (r"stage\.levels\.(\d)\.enlarge", lambda i: f"{_STAGE}.udisp{6 - i}.0"),
    (r"stage\.levels\.(\d)\.fuse\.0", lambda i: f"{_STAGE}.iconv{5 - i}.0.0"),
    (r"stage\.levels\.(\d)\.predict", lambda i: f"{_STAGE}.disp{5 - i}.0.0"),
    (r"full\.up\.0", lambda: f"{_STAGE}.uconv0.0"),
    (r"full\.enlarge", lambda: f"{_STAGE}.udisp1.0"),
    (r"full\.fuse\.0", lambda: f"{_STAGE}.iconv0.0.0"),
    (r"full\.predict", lambda: f"{_STAGE}.disp0.0.0"),
    (r"compress\.0", lambda: f"{_REFINEMENT}.c_conv1.0.0"),
    (r"refinement\.conv([01])\.0", lambda i: f"{_REFINEMENT}.r_conv{i}.0.0"),
    (r"refinement\.conv1b\.0", lambda: f"{_REFINEMENT}.r_conv1_1.0.0"),
    (r"refinement\.conv2\.0\.0", lambda: f"{_REFINEMENT}.r_conv2.0.0"),
    (r"refinement\.conv2\.1\.0", lambda: f"{_REFINEMENT}.r_conv2_1.0.0"),
    (r"refinement\.predict2", lambda: f"{_REFINEMENT}.r_res2.0.0"),
    (r"refinement\.level(\d)\.up\.0", lambda i: f"{_REFINEMENT}.r_uconv{i}.0"),
    (r"refinement\.level(\d)\.enlarge", lambda i: f"{_REFINEMENT}.r_res{i + 1}_up.0"),
    (r"refinement\.level(\d)\.fuse\.0", lambda i: f"{_REFINEMENT}.r_iconv{i}.0.0"),
    (r"refinement\.level(\d)\.predict", lambda i: f"{_REFINEMENT}.r_res{i}.0.0"),
]


def reversing_key(key: str) -> str:
    """The authors' name for a name in our state dict."""
    return translated_name(key, _RULES)


def from_reversing(weights: WeightsFile) -> WeightsFile:
    """Translate a checkpoint of "Reversing the cycle"; any other is given back as it is.

    The authors concatenate in other orders than the Caffe release: the input channels of the
    convolutions after a concatenation change places.

    Raises:
        InputError: If some names are of that release, but not all, or there are more.
    """
    prefix = next((key.partition(_MARK)[0] for key in weights.state if _MARK in key), None)
    if prefix is None:
        return weights
    state = {key.removeprefix(prefix): value for key, value in weights.state.items()}
    own = {key: reversing_key(key) for key in registered_shapes(MODEL)}
    if wrong := set(own.values()) ^ state.keys():
        raise InputError(
            f"{weights.source}: not the iResNet of Reversing the cycle: {len(wrong)} tensors "
            f"missing or unknown, such as {min(wrong)!r}"
        )
    translated = {key: state[released] for key, released in own.items()}
    for key in [key for key in own if key.endswith("fuse.0.weight")]:
        up = translated[key.replace("fuse", "up")].shape[1]
        translated[key] = _reorder(translated[key], (up, 1), (2, 0, 1))
    features = len(translated["project.0.weight"])
    key = "refinement.conv0.0.weight"
    translated[key] = _reorder(translated[key], (features, 1), (2, 1, 0))
    conv1 = len(translated["refinement.conv1.0.weight"])
    key = "refinement.conv1b.0.weight"
    translated[key] = _reorder(translated[key], (conv1,), (1, 0))
    return WeightsFile(weights.source, translated, MODEL)


def _reorder(weight: Tensor, sizes: tuple[int, ...], order: tuple[int, ...]) -> Tensor:
    """Groups of input channels in another order.

    Args:
        weight: (out, in, k, k).
        sizes: Sizes of all groups but the last.
        order: Places of the groups.
    """
    groups = weight.split([*sizes, weight.shape[1] - sum(sizes)], dim=1)
    return torch.cat([groups[place] for place in order], dim=1)
