"""A side-by-side video of a procedural scene with a moving camera, to try `msnet video` on.

python benchmarks/moving_camera.py scene.mp4 [--frames 30] [--scene 3] [--seed 0]

It prints the scene's focal length and baseline, which `msnet video` takes for depth.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.progress import track

from mobilestereonet.data.images import Picture, to_picture
from mobilestereonet.scenes import ProceduralScenes, SceneConfig
from mobilestereonet.scenes.builder import yaw_rotations
from mobilestereonet.scenes.scene import Scene
from mobilestereonet.streams.video_files import write_video


def moved(scene: Scene, place: np.ndarray, turn: float) -> Scene:
    """The scene as cameras see it that went to ``place`` (m) and turned right by ``turn``."""
    rotation = yaw_rotations(-turn)[0]
    surfaces = scene.surfaces
    return replace(
        scene,
        light=rotation @ (scene.light - place),
        focus=rotation @ (scene.focus - place),
        surfaces=replace(
            surfaces,
            centre=(surfaces.centre - place) @ rotation.T,
            axes=rotation @ surfaces.axes,
        ),
    )


class MovingCamera(ProceduralScenes):
    """Frames of one scene as if they were scenes: the cameras drift sideways and ahead."""

    def __init__(self, config: SceneConfig, scene: int, frames: int) -> None:
        super().__init__(config)
        self.scene, self.frames = super().scene(scene), frames

    def scene(self, index: int) -> Scene:
        scene, share = self.scene, index / self.frames
        reach = scene.spread / 2.5  # the distance of the nearest things
        sideways = 0.25 * reach * np.sin(2 * np.pi * share)
        return moved(scene, np.array([sideways, 0, 0.3 * reach * share]), 0.08 * share)


def moments(camera: MovingCamera, fps: float) -> Iterator[tuple[float, Picture]]:
    for index in track(range(camera.frames), "rendering"):
        sample = camera[index]
        views = [to_picture(view) for view in (sample.left, sample.right)]
        yield index / fps, np.concatenate(views, axis=1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("video", type=Path)
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--fps", type=float, default=10)
    parser.add_argument("--scene", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--size", type=int, nargs=2, default=(256, 512), help="height and width")
    arguments = parser.parse_args()

    height, width = arguments.size
    config = SceneConfig(height=height, width=width, max_disparity=96, seed=arguments.seed)
    camera = MovingCamera(config, arguments.scene, arguments.frames)
    write_video(arguments.video, moments(camera, arguments.fps))
    scene = camera.scene
    print(f"{arguments.video}: {scene.kind}, --focal {scene.focal:.1f} --baseline {scene.baseline}")


if __name__ == "__main__":
    main()
