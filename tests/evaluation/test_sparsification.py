import cv2
import numpy as np
import pytest

from mobilestereonet.errors import InputError
from mobilestereonet.evaluation.sparsification import plot_sparsification, sparsification

ERROR = np.arange(1000, dtype=np.float32).reshape(20, 50)


def test_perfect_confidence_is_the_oracle():
    curve = sparsification(ERROR, -ERROR)
    np.testing.assert_array_equal(curve.error, curve.oracle)
    assert curve.area == 0
    # Without the largest 40 % the errors 0 to 599 are left.
    assert curve.removed[40] == 0.4
    assert curve.error[40] == pytest.approx(299.5)


def test_the_worst_confidence_leaves_the_largest_errors():
    curve = sparsification(ERROR, ERROR)
    assert curve.error[0] == pytest.approx(499.5)
    assert curve.error[40] == pytest.approx((400 + 999) / 2)
    assert curve.oracle[40] == pytest.approx(299.5)
    # Both curves are straight lines that are (nearly) 0 and 999 apart at either end.
    assert curve.area == pytest.approx(1, abs=0.02)


def test_chance_keeps_the_mean():
    chance = np.random.default_rng(0).random(ERROR.shape).astype(np.float32)
    curve = sparsification(ERROR, chance)
    np.testing.assert_allclose(curve.error[:50], 499.5, rtol=0.05)


def test_no_error_at_all():
    assert sparsification(np.zeros(7, np.float32), np.ones(7, np.float32)).area == 0


def test_refused():
    for error in (np.zeros(3, np.float32), np.zeros(0, np.float32)):
        with pytest.raises(InputError, match="one shape with a pixel"):
            sparsification(error, np.zeros(error.size // 2, np.float32))


def test_plot(tmp_path):
    plot_sparsification([("one", sparsification(ERROR, -ERROR))], tmp_path / "curve.png")
    assert cv2.imread(str(tmp_path / "curve.png")).std() > 0
