"""Weights of the Caffe releases: DispNet-Corr1D, CRL and iResNet."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from mobilestereonet.errors import InputError, needs_extra
from mobilestereonet.weights.files import WeightsFile
from mobilestereonet.weights.names import Rule, translated_name
from mobilestereonet.weights.shapes import registered_shapes

ENDING = ".caffemodel"
_BLOBS = ("weight", "bias")
"""Blobs of a layer in their order."""

_STAGE: list[Rule] = [
    (r"conv(\d)\.0\.0", lambda i: f"conv{i}"),
    (r"conv(\d)\.1\.0", lambda i: f"conv{i}_1"),
    (r"conv(\d)\.0", lambda i: f"conv{i}"),
    (r"redirect\.0", lambda: "conv_redir"),
    (r"predict6", lambda: "Convolution1"),
    (r"levels\.(\d)\.up\.0", lambda i: f"deconv{5 - i}"),
    (r"levels\.(\d)\.enlarge", lambda i: f"upsample_flow{6 - i}to{5 - i}"),
    (r"levels\.(\d)\.fuse\.0", lambda i: f"Convolution{2 * i + 2}"),
    (r"levels\.(\d)\.predict", lambda i: f"Convolution{2 * i + 3}"),
    (r"up\.0", lambda: "deconv2"),
    (r"enlarge", lambda: "upsample_flow3to2"),
    (r"predict", lambda: "Convolution8"),
]

_FULL: list[Rule] = [
    (r"full\.up\.0", lambda: "deconv0"),
    (r"full\.enlarge", lambda: "upsample_flow1to0"),
]

_RULES: dict[str, list[Rule]] = {
    "dispnet-corr1d": [],
    "crl": [
        *_FULL,
        (r"full\.fuse\.0", lambda: "Convolution12"),
        (r"full\.predict", lambda: "Convolution13"),
    ],
    "iresnet": [
        *_FULL,
        (r"full\.fuse\.0", lambda: "Convolution21"),
        (r"full\.predict", lambda: "Convolution22"),
        (r"multi_scale\.up(\d)\.0", lambda i: f"up_conv{i}ab"),
        (r"project_left\.0", lambda: "up_conv1a2a"),
        (r"project_right\.0", lambda: "up_conv1b2b"),
        (r"compress\.0", lambda: "compress_conv1a1b"),
        (r"refinement\.conv2\.0\.0", lambda: "zoom_conv2_itr1"),
        (r"refinement\.conv2\.1\.0", lambda: "zoom_conv2b_itr1"),
        (r"refinement\.conv1b\.0", lambda: "zoom_conv1b_itr1"),
        (r"refinement\.conv(\d)\.0", lambda i: f"zoom_conv{i}_itr1"),
        (r"refinement\.predict2", lambda: "zoom_Convolution2_itr1"),
        (r"refinement\.level(\d)\.up\.0", lambda i: f"zoom_deconv{i + 1}_itr1"),
        (r"refinement\.level(\d)\.enlarge", lambda i: f"zoom_upsample_{i + 1}to{i}_itr1"),
        (r"refinement\.level(\d)\.fuse\.0", lambda i: f"zoom_fused{i}_itr1"),
        (r"refinement\.level(\d)\.predict", lambda i: f"zoom_Convolution{i}_itr1"),
    ],
}


def caffe_key(key: str, network: str) -> str:
    """Name of a layer and "weight" or "bias" in a Caffe release, for a name in our state dict.

    Args:
        key: Our name.
        network: Registered name of the network, one of those that have a Caffe release.
    """
    part, _, rest = key.partition(".")
    if part not in ("stage", "stage1", "stage2"):
        return translated_name(key, _RULES[network])
    layer, _, kind = translated_name(rest, _STAGE).rpartition(".")
    return f"{layer}_s2.{kind}" if part == "stage2" else f"{layer}.{kind}"


def read_caffemodel(path: Path) -> WeightsFile:
    """Read a ``.caffemodel`` of DispNet-Corr1D, CRL or iResNet; extra ``caffe``.

    Raises:
        InputError: If the file is damaged or holds another network, or without the extra.
    """
    layers = _read_layers(path)
    name = "dispnet-corr1d"
    if any(layer.endswith("_s2") for layer in layers):
        name = "crl"
    elif any(layer.startswith("zoom_") for layer in layers):
        name = "iresnet"
    state, missing = {}, []
    for key, shape in registered_shapes(name).items():
        if key == "means":
            continue
        layer, _, kind = caffe_key(key, name).rpartition(".")
        values = layers.get(layer, [])[_BLOBS.index(kind) :][:1]
        if values and values[0].numel() == shape.numel():
            state[key] = values[0].reshape(shape)  # old files have shapes of another form
        else:
            missing.append(layer)
    if missing:
        raise InputError(
            f"{path}: not the release of DispNet-Corr1D, CRL or iResNet: {len(missing)} of "
            f"{len(state) + len(missing)} tensors of {name} are missing or have another size, "
            f"such as that of {missing[0]!r}"
        )
    return WeightsFile(str(path), {**state, "means": _means(path, layers)}, name)


def _means(path: Path, layers: dict[str, list[Tensor]]) -> Tensor:
    """Means of blue, green and red of either view, (2, 3): third blobs of the augmentation."""
    blobs = [layers.get(f"img{view}s_aug", [])[2:3] for view in (0, 1)]
    if any(len(blob) != 1 or blob[0].numel() != 3 for blob in blobs):
        raise InputError(
            f"{path}: lacks the views' mean colours (3 values in the third blob of the layers "
            "img0s_aug and img1s_aug)"
        )
    return torch.stack([blob[0] for blob in blobs])


def _read_layers(path: Path) -> dict[str, list[Tensor]]:
    """Values of the blobs, one after the other, by the name of the layer."""
    with needs_extra("caffe"):
        from google.protobuf.message import DecodeError
    net = _net_message()()
    try:
        net.ParseFromString(path.read_bytes())
        return {
            layer.name: [
                torch.from_numpy(np.frombuffer(blob.data, "<f4").astype(np.float32))
                for blob in layer.blobs
            ]
            for layer in net.layer
        }
    except (DecodeError, ValueError) as error:
        raise InputError(f"{path}: not a whole Caffe model: {error}") from None


@cache
def _net_message() -> Any:
    """Class of Caffe's NetParameter, with the fields that are read: layers, and their blobs."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    field = descriptor_pb2.FieldDescriptorProto
    messages: dict[str, list[tuple[Any, ...]]] = {
        # Packed floats, as bytes: a float each as an object would take minutes.
        "Blob": [("data", 5, field.TYPE_BYTES, None, field.LABEL_OPTIONAL)],
        "Layer": [
            ("name", 1, field.TYPE_STRING, None, field.LABEL_OPTIONAL),
            ("blobs", 7, field.TYPE_MESSAGE, ".caffe.Blob", field.LABEL_REPEATED),
        ],
        "Net": [("layer", 100, field.TYPE_MESSAGE, ".caffe.Layer", field.LABEL_REPEATED)],
    }
    file = descriptor_pb2.FileDescriptorProto(name="caffe.proto", package="caffe")
    for message, fields in messages.items():
        described = file.message_type.add(name=message)
        for name, number, kind, type_name, label in fields:
            described.field.add(
                name=name, number=number, type=kind, type_name=type_name, label=label
            )
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("caffe.Net"))
