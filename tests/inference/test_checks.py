import re

import cv2
import numpy as np
import pytest

from mobilestereonet.inference.checks import check_pair, quick_checks


def scene(shift=0.0, down=0.0, angle=0.0, gain=1.0):
    """A textured plane seen from a place to the right: its points move left by 20 to 40 px."""
    noise = np.random.default_rng(0).integers(0, 256, (300, 520, 3), dtype=np.uint8)
    texture = cv2.GaussianBlur(noise, (0, 0), 2).astype(np.float32)
    texture = ((texture - texture.mean()) * 3 + 110).clip(0, 255)
    rows, columns = np.mgrid[:240, :400].astype(np.float32)
    turned = cv2.transform(
        np.stack((columns, rows), axis=2), cv2.getRotationMatrix2D((200, 120), angle, 1)
    )
    x = turned[..., 0] * (1 - 0.05 * (shift != 0)) + shift + 50
    view = cv2.remap(texture, x, turned[..., 1] + down + 30, cv2.INTER_CUBIC)
    return (view * gain).clip(0, 255).astype(np.uint8)


def levels(left, right, **options):
    return {finding.check: finding.level for finding in check_pair(left, right, **options)}


GOOD = dict.fromkeys(("content", "exposure", "rectified", "order", "range"), "good")


def test_a_good_pair():
    assert levels(scene(), scene(40)) == GOOD
    assert levels(scene(), scene(40), max_disparity=48) == GOOD


@pytest.mark.parametrize(
    ("left", "right", "check", "level", "words"),
    [
        ({"shift": 40}, {}, "order", "problem", "swapped: exchange.*converge"),
        ({}, {"shift": -10}, "order", "problem", "the views are swapped"),
        ({}, {"shift": 40, "down": 3}, "rectified", "problem", "3.0 px higher.*view down"),
        ({}, {"shift": 40, "down": -3}, "rectified", "problem", "3.0 px lower.*view up"),
        ({}, {"shift": 40, "down": 1}, "rectified", "warning", "1.0 px higher"),
        ({}, {"shift": 40, "angle": 3}, "rectified", "problem", "msnet rectify"),
        ({}, {"shift": 40, "gain": 0.5}, "exposure", "warning", "factor of 2.0.*lock exposure"),
        ({}, {}, "content", "problem", "same picture"),
        ({}, {"gain": 0.9}, "views", "problem", "nothing moves"),
        ({}, {"gain": 0.0}, "content", "problem", "right view is blank"),
    ],
)
def test_what_is_wrong_is_said(left, right, check, level, words):
    findings = {finding.check: finding for finding in check_pair(scene(**left), scene(**right))}
    assert findings[check].level == level
    assert findings[check].advice
    assert re.search(words, str(findings[check]))


def in_thirds(first, rest):
    """A view whose upper third is that of another one."""
    third = len(first) // 3
    return np.vstack((first[:third], rest[third:]))


def test_swapped_views_of_which_a_part_is_far():
    pair = in_thirds(scene(), scene(40)), scene()
    findings = {finding.check: finding for finding in check_pair(*pair)}
    assert "the views are swapped" in findings["order"].advice


def test_converging_cameras():
    findings = {
        finding.check: finding for finding in check_pair(scene(), in_thirds(scene(-20), scene(40)))
    }
    assert "negative disparity" in findings["order"].text
    assert "swapped" not in str(findings["order"])


def test_no_disparity_is_minus_nothing():
    far = cv2.warpAffine(scene(), np.float32([[1, 0, 0.3], [0, 1, 0]]), (400, 240))
    findings = check_pair(scene(), in_thirds(far, scene(40)))
    assert "disparities go from 0 to" in str(findings[-1])


def test_range():
    (finding,) = [f for f in check_pair(scene(), scene(40), 32) if f.check == "range"]
    assert finding.level == "problem"
    # The largest disparity is 40 px: 0.9 * 31 / 40.
    assert "0.7" in finding.advice


def test_cameras_one_above_the_other():
    pair = [np.rot90(view).copy() for view in (scene(), scene(40))]
    findings = {finding.check: finding for finding in check_pair(*pair)}
    assert findings["orientation"].level == "problem"
    assert "turn both views by 90 degrees" in findings["orientation"].advice


def test_two_scenes_cannot_be_told():
    left, right = np.random.default_rng(0).integers(0, 256, (2, 200, 300, 3), dtype=np.uint8)
    assert levels(left, right)["geometry"] == "unknown"
    grey = np.full_like(left, 128)
    grey[:, ::2] += 20
    assert levels(grey, left)["geometry"] == "unknown"


def test_quick_checks_are_the_first_two():
    assert [finding.check for finding in quick_checks(scene(), scene(40))] == list(GOOD)[:2]
