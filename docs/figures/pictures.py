"""Makes the pages' pictures: what rectified means, bad pairs, confidence, scenes, the gallery.

python docs/figures/pictures.py [NAME ...]

They need the extra demo and some minutes: the networks match a few dozen pairs. Nothing but
scikit-image's Motorcycle and scenes without photographs is shown.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import torch
from sheets import sheet, write

from mobilestereonet.data.images import Picture, to_picture
from mobilestereonet.data.motorcycle import motorcycle
from mobilestereonet.data.sample import StereoSample, collate
from mobilestereonet.inference import StereoMatcher, StereoResult, check_pair
from mobilestereonet.metrics import StereoMetrics
from mobilestereonet.plots import colour_disparity, error_map
from mobilestereonet.scenes import ProceduralScenes
from mobilestereonet.training.named_recipes import get_recipe

IMAGES = Path(__file__).parents[1] / "images"

LINES = ((255, 193, 7), (0, 200, 83), (41, 182, 246), (236, 64, 122), (171, 71, 188))

GALLERY_SEED, GALLERY_SCENES = 20_000, 12
SHEET_SEED, SHEET_SCENES = 30_000, 8


def rectified() -> Picture:
    """Lines through matching points: level in a rectified pair, and not in a rotated one."""
    sample = motorcycle()
    left, right = to_picture(sample.left), to_picture(sample.right)
    points = _corners(sample)
    assert sample.disparity is not None
    there = [(x - float(sample.disparity[y, x]), float(y)) for x, y in points]
    turn = cv2.getRotationMatrix2D((370, 250), 4, 1) + np.array([[0, 0, 0], [0, 0, 14]])
    turned = cv2.warpAffine(right, turn, right.shape[1::-1], borderMode=cv2.BORDER_REPLICATE)
    moved = [tuple(turn @ (x, y, 1)) for x, y in there]
    good = [_marked(left, points, points), _marked(right, there, points)]
    bad = [_marked(left, points, points), _marked(turned, moved, points)]
    captions = [
        "rectified: each line goes through the same point of both views",
        "not rectified (right camera turned by 4 degrees): the point has left its row",
    ]
    return sheet([good, bad], width=620, captions=captions)


def _corners(sample: StereoSample) -> list[tuple[int, int]]:
    """Five points with texture and ground truth, one in each fifth of the height."""
    grey = cv2.cvtColor(to_picture(sample.left), cv2.COLOR_RGB2GRAY)
    assert sample.valid is not None
    known = cv2.erode(sample.valid.numpy().astype(np.uint8), np.ones((15, 15), np.uint8))
    strength = np.where(known > 0, cv2.cornerMinEigenVal(grey, 7), 0)
    strength[:, :150] = strength[:, 680:] = 0
    bands = np.array_split(np.arange(40, 460), 5)
    columns = ((150, 420), (350, 680), (150, 420), (350, 680), (150, 500))
    places = []
    for band, (start, end) in zip(bands, columns, strict=True):
        part = strength[band[0] : band[-1], start:end]
        y, x = np.unravel_index(part.argmax(), part.shape)
        places.append((int(x) + start, int(y) + int(band[0])))
    return places


def _marked(
    view: Picture, points: list[tuple[float, float]] | list[tuple[int, int]], rows: list
) -> Picture:
    """A view with the rows of the left view's points, and a ring around each point of its own."""
    view = view.copy()
    for colour, (x, y), (_, row) in zip(LINES, points, rows, strict=True):
        cv2.line(view, (0, int(row)), (view.shape[1], int(row)), colour, 2, cv2.LINE_AA)
        cv2.circle(view, (round(x), round(y)), 13, colour, 3, cv2.LINE_AA)
    return view


def bad_pairs() -> Picture:
    """Five pairs, what the checks say first, and what msnet3d makes of them unasked."""
    sample = motorcycle()
    left, right = to_picture(sample.left), to_picture(sample.right)
    size = left.shape[1::-1]
    turn = cv2.getRotationMatrix2D((370, 250), 2, 1)
    near = [_enlarged(left), _enlarged(right)]
    pairs = {
        "views swapped": (right, left),
        "rows do not match": (left, cv2.warpAffine(right, turn, size)),
        "one view darker": (left, (right * 0.3).astype(np.uint8)),
        "one view upside down": (left, np.ascontiguousarray(right[::-1, ::-1])),
        "too near": (near[0], near[1]),
    }
    matcher = StereoMatcher.from_pretrained("msnet3d")
    rows, captions = [], []
    for name, pair in pairs.items():
        disparity = matcher(*pair, look=False).disparity
        rows.append([*pair, colour_disparity(disparity)])
        found = [finding for finding in check_pair(*pair) if finding.level != "good"]
        captions.append(f"{name}: {found[0].text}" if found else f"{name}: nothing found")
        print(captions[-1])
    return sheet(rows, width=420, captions=captions)


def _enlarged(view: Picture) -> Picture:
    """A quarter of a view, four times as large: disparities are four times as large, too."""
    part = view[200:325, 250:435]
    return cv2.resize(part, (740, 500), interpolation=cv2.INTER_CUBIC)


def confidence() -> Picture:
    """Left view, disparity, error and confidence of the Motorcycle."""
    sample = motorcycle()
    matcher = StereoMatcher.from_pretrained("msnet3d", confidence=True)
    result = matcher(to_picture(sample.left), to_picture(sample.right))
    assert result.confidence is not None
    assert sample.disparity is not None
    levels = (255 * result.confidence).astype(np.uint8)
    sure = cv2.applyColorMap(levels, cv2.COLORMAP_CIVIDIS)[..., ::-1]
    wrong = error_map(result.disparity, sample.disparity, sample.valid)
    panels = [result.left, colour_disparity(result.disparity), wrong, np.ascontiguousarray(sure)]
    captions = [
        "left view, and disparity",
        "error (red is wrong, black has no ground truth), and confidence (yellow is sure)",
    ]
    return sheet([panels[:2], panels[2:]], width=620, captions=captions)


def scenes() -> Picture:
    """Left view and disparity of some procedural scenes."""
    rendered = _scenes(SHEET_SEED, SHEET_SCENES)
    rows = []
    for start in range(0, SHEET_SCENES, 4):
        four = rendered[start : start + 4]
        rows.append([to_picture(sample.left) for sample in four])
        rows.append([colour_disparity(_truth(sample), _range(sample)) for sample in four])
    return sheet(rows, width=320)


def _scenes(seed: int, count: int) -> list[StereoSample]:
    config = replace(get_recipe("procedural").scenes, height=256, width=512, seed=seed)
    made = ProceduralScenes(config)
    return [made[index] for index in range(count)]


def _truth(sample: StereoSample) -> torch.Tensor:
    assert sample.disparity is not None
    return sample.disparity


def _range(sample: StereoSample) -> float:
    assert sample.valid is not None
    return float(np.percentile(_truth(sample)[sample.valid].numpy(), 99))


MODELS = ("msnet3d", "msnet2d", "sgbm")
TITLES = ("left view", "ground truth", *MODELS[:2], "StereoSGBM")


def gallery() -> dict[str, Picture]:
    """The Motorcycle, a typical scene and the worst; and all scenes, the best first."""
    samples = [motorcycle(), *_scenes(GALLERY_SEED, GALLERY_SCENES)]
    rows, errors = [], []
    matchers = [StereoMatcher.from_pretrained(name) for name in MODELS]
    for sample in samples:
        results = [matcher(sample.left, sample.right) for matcher in matchers]
        errors.append([_figures(result, sample) for result in results])
        top = _range(sample)
        truth = colour_disparity(_truth(sample), top, sample.valid)
        maps = [colour_disparity(result.disparity, top) for result in results]
        rows.append([to_picture(sample.left), truth, *maps])
        print(sample.name, *(f"{error['d1']:.1f} %" for error in errors[-1]), flush=True)
    order = sorted(range(1, len(samples)), key=lambda index: errors[index][0]["d1"])

    def panel(chosen: list[int]) -> Picture:
        captions = [
            ["", "", *(f"EPE {e['epe']:.2f} px, D1 {e['d1']:.1f} %" for e in errors[i])]
            for i in chosen
        ]
        return sheet(
            [rows[i] for i in chosen], width=300, titles=TITLES, captions=captions, text_px=25
        )

    return {
        "gallery": panel([0, order[len(order) // 2], order[-1]]),
        "gallery_scenes": panel(order),
    }


def _figures(result: StereoResult, sample: StereoSample) -> dict[str, float]:
    metrics = StereoMetrics()
    metrics.update(torch.from_numpy(result.disparity)[None], collate([sample]))
    return metrics.compute().figures()


FIGURES: dict[str, Callable[[], Picture | dict[str, Picture]]] = {
    function.__name__: function for function in (rectified, bad_pairs, confidence, scenes, gallery)
}


def main() -> None:
    """Write the pictures that are asked for, or all."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("names", nargs="*", default=list(FIGURES), metavar="NAME")
    for name in parser.parse_args().names:
        made = FIGURES[name]()
        for file, picture in (made if isinstance(made, dict) else {name: made}).items():
            write(IMAGES / f"{file}.jpg", picture)


if __name__ == "__main__":
    main()
