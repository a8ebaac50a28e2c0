"""Matching of many pairs on a Ray cluster."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import cv2

from mobilestereonet.errors import InputError, needs_extra
from mobilestereonet.inference import Rectifier, StereoMatcher
from mobilestereonet.inference.arrangement import AS_GIVEN, Arrangement
from mobilestereonet.streams.batch import PairStatus, match_pairs
from mobilestereonet.streams.maps import MapFiles
from mobilestereonet.streams.pairs import PairFiles

PAIRS_PER_TASK = 8
"""Pairs that a worker gets at a time: few, so that the workers end together."""


class _Worker:
    """One process of the cluster, with a matcher of its own."""

    def __init__(
        self,
        pairs: Sequence[PairFiles],
        files: MapFiles,
        make_matcher: Callable[[], StereoMatcher],
        cpus: int,
        rectifier: Rectifier | None,
        arrangement: Arrangement,
    ) -> None:
        cv2.setNumThreads(cpus)  # OpenCV takes all cores of the machine if it is not told
        self.pairs, self.files = pairs, files
        self.rectifier, self.arrangement = rectifier, arrangement
        self.matcher = make_matcher()

    def __call__(self, rows: dict[str, Any]) -> dict[str, Any]:
        pairs = [self.pairs[index] for index in rows["item"]]
        # A task whose worker died is given to another one, which finds what is finished.
        todo = self.files.unfinished(pairs)
        statuses = [PairStatus(pair.name) for pair in pairs if pair not in todo]
        statuses += match_pairs(
            todo,
            self.matcher,
            self.files,
            rectifier=self.rectifier,
            arrangement=self.arrangement,
        )
        return {
            "name": [status.name for status in statuses],
            "problem": [status.problem for status in statuses],
        }


def match_on_ray(
    pairs: Sequence[PairFiles],
    files: MapFiles,
    make_matcher: Callable[[], StereoMatcher],
    *,
    rectifier: Rectifier | None = None,
    address: str = "local",
    workers: int = 2,
    cpus: int = 1,
    gpus: float = 0,
    arrangement: Arrangement = AS_GIVEN,
) -> Iterator[PairStatus]:
    """Match pairs on a Ray cluster and write their maps.

    What is finished is never matched again: neither what an earlier run left, nor what a worker
    had written before it died. All machines need the same package, and the pairs, the weights and
    the output in folders of the same names.

    Args:
        pairs: Files of their views.
        files: Files of their maps.
        make_matcher: Makes a worker's matcher.
        rectifier: Rectifies all pairs, and has their calibration.
        address: The cluster's; "local" starts one on this machine for the time being.
        workers: How many processes.
        cpus: Processor cores of each.
        gpus: GPUs of each.
        arrangement: What puts all pairs right, see `look_at_pairs`.

    Yields:
        The status of each pair, in any order.

    Raises:
        InputError: If Ray is not installed, the cluster cannot be reached, or a worker fails in
            another way than by dying, such as on weights that its machine does not have.
    """
    with needs_extra("ray"):
        import ray
        import ray.data
    todo = files.unfinished(pairs)
    if not todo:
        return
    local = {"num_cpus": workers * cpus, "include_dashboard": False} if address == "local" else {}
    try:
        ray.init(address=address, log_to_driver=False, logging_level="ERROR", **local)
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise InputError(f"no Ray cluster at {address!r}: {error}") from error
    logger, context = logging.getLogger("ray.data"), ray.data.DataContext.get_current()
    level, bars = logger.level, context.enable_progress_bars
    try:
        logger.setLevel(logging.ERROR)
        context.enable_progress_bars = False
        tasks = -(-len(todo) // PAIRS_PER_TASK)
        statuses = ray.data.from_items(list(range(len(todo))), override_num_blocks=tasks)
        statuses = statuses.map_batches(
            _Worker,
            fn_constructor_args=(todo, files, make_matcher, cpus, rectifier, arrangement),
            batch_size=None,
            compute=ray.data.ActorPoolStrategy(size=min(workers, tasks)),
            num_cpus=cpus,
            num_gpus=gpus,
        )
        for row in statuses.iter_rows():
            yield PairStatus(row["name"], row["problem"])
    except ray.exceptions.RayError as error:
        # What Ray tells ends with the line that the worker's own error had.
        raise InputError(f"a worker failed: {str(error).strip().splitlines()[-1]}") from error
    finally:
        logger.setLevel(level)
        context.enable_progress_bars = bars
        ray.shutdown()
