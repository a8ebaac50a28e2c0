import itertools
import math

import cv2
import pytest
from matplotlib.text import Annotation

from mobilestereonet.errors import InputError
from mobilestereonet.evaluation import ParetoPoint, pareto_front, plot_pareto
from mobilestereonet.evaluation.pareto import draw_pareto

FAST, EVEN, GOOD = (
    ParetoPoint("fast", 0.1, 8.0),
    ParetoPoint("even", 1.0, 5.0),
    ParetoPoint("good", 3.0, 4.0),
)
BEATEN = ParetoPoint("slower and worse", 2.0, 6.0)
SLOWER = ParetoPoint("as good, but slower", 4.0, 4.0)
WORSE = ParetoPoint("as fast, but worse", 1.0, 5.5)


def test_the_front_has_who_is_beaten_by_nobody():
    for points in itertools.permutations([GOOD, BEATEN, FAST, SLOWER, EVEN, WORSE]):
        assert pareto_front(points) == [FAST, EVEN, GOOD]
    twin = GOOD._replace(name="another name")
    assert pareto_front([GOOD, EVEN, twin]) == [EVEN, GOOD, twin]


def test_labels_cover_nothing():
    crowd = [ParetoPoint(f"network {i}", 1 + 0.1 * i, 6 - 0.3 * i) for i in range(6)]
    crowd += [ParetoPoint("StereoSGBM", 0.15, 7.3), ParetoPoint("at the end", 4.0, 4.1)]
    figure = draw_pareto(crowd, "seconds", "D1, %")
    (axes,) = figure.axes
    assert axes.get_xscale() == "log"
    labels = [child for child in axes.get_children() if isinstance(child, Annotation)]
    assert [label.get_text() for label in labels] == [point.name for point in crowd]
    boxes = [label.get_window_extent() for label in labels]
    assert not any(a.overlaps(b) for a, b in itertools.combinations(boxes, 2))
    places = axes.transData.transform([point[1:] for point in crowd])
    assert not any(box.contains(*place) for box in boxes for place in places)
    for box in boxes:
        assert axes.bbox.count_contains(box.corners()) == 4


def test_the_picture(tmp_path):
    plot_pareto([FAST, GOOD, BEATEN], tmp_path / "pareto.png", "seconds", "D1, %")
    height, width = cv2.imread(str(tmp_path / "pareto.png")).shape[:2]
    assert 700 < width < 1000 and height < width


@pytest.mark.parametrize("seconds", [0.0, math.inf, math.nan])
def test_bad_points(tmp_path, seconds):
    with pytest.raises(InputError, match="at least one point"):
        plot_pareto([], tmp_path / "pareto.png")
    with pytest.raises(InputError, match="fast: a time must be positive"):
        plot_pareto([FAST._replace(seconds=seconds)], tmp_path / "pareto.png")
    assert not list(tmp_path.iterdir())
