"""Rigs from every description of a stereo camera that is known."""

import codecs
from dataclasses import replace

import cv2
import numpy as np
import pytest
import rig_files as files
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from rig_files import BASELINE, CAMERA, FISHEYE, FOCAL, RAW, RECTIFIED, SIZE

from mobilestereonet.data import Calibration, Rig, read_calibration
from mobilestereonet.data.rig import CameraPair
from mobilestereonet.data.rig.opencv import find_names
from mobilestereonet.errors import InputError
from mobilestereonet.inference import Rectifier

FORMATS = files.RAW_FORMATS | files.RECTIFIED_FORMATS


def depth(calibration, disparity=20.0):
    return calibration.focal * calibration.baseline / (disparity + calibration.doffs)


@pytest.mark.parametrize("name", FORMATS)
def test_depth_is_equal_through_each_format(tmp_path, name):
    rig = Rig.read(FORMATS[name](tmp_path, RECTIFIED))
    calibration = rig.geometry(SIZE)
    assert isinstance(calibration, Calibration)  # nothing is to be rectified
    assert depth(calibration) == pytest.approx(FOCAL * BASELINE / 20, rel=1e-6)
    assert calibration.principal_point(*SIZE) == pytest.approx((files.CX, files.CY), abs=1e-4)
    assert Rectifier(rig).calibration(SIZE) == replace(calibration, size=SIZE)
    assert not [note for note in rig.notes if "taken for" in note]


@pytest.mark.parametrize("name", files.RAW_FORMATS)
def test_raw_cameras_are_equal_through_each_format(tmp_path, name):
    pair = Rig.read(FORMATS[name](tmp_path, RAW)).geometry(SIZE)
    assert isinstance(pair, CameraPair)
    np.testing.assert_allclose(pair.rotation, RAW.rotation, atol=1e-6)
    np.testing.assert_allclose(pair.translation, RAW.translation, atol=1e-6)
    for camera in (pair.left, pair.right):
        np.testing.assert_allclose(camera.matrix, CAMERA)
        np.testing.assert_allclose(camera.distortion[:4], RAW.distortion)
        assert not camera.fisheye


@pytest.mark.parametrize("name", ["ros", "kalibr", "euroc", "oak", "realsense", "orb-slam3"])
def test_fisheye_lenses_are_known_by_their_models(tmp_path, name):
    rig = Rig.read(FORMATS[name](tmp_path, FISHEYE))
    pair = rig.geometry(SIZE)
    np.testing.assert_allclose(pair.rotation, FISHEYE.rotation, atol=1e-6)
    for camera in (pair.left, pair.right):
        np.testing.assert_array_equal(camera.distortion, FISHEYE.distortion)
        assert camera.fisheye
    assert Rectifier(rig).calibration(SIZE).baseline == pytest.approx(0.12, rel=1e-3)


def test_four_numbers_without_a_model_are_asked_about(tmp_path):
    path = files.storage(tmp_path / "rig.yml", files.opencv(FISHEYE))
    with pytest.raises(InputError, match=r"rig\.yml: .*--fisheye .*--pinhole"):
        Rig.read(path)
    for fisheye in (True, False):
        assert Rig.read(path, fisheye=fisheye).geometry(SIZE).left.fisheye == fisheye
    with pytest.raises(InputError, match="distortion model is equidistant: leave out --pinhole"):
        Rig.read(files.kalibr(tmp_path, FISHEYE), fisheye=False)


ENCODINGS = {
    "mark": ("utf-8-sig", "\n"),
    "windows": ("utf-8", "\r\n"),
    "utf-16": ("utf-16", "\r\n"),
    "utf-16-le": ("utf-16-le", "\n"),
    "utf-16-be": ("utf-16-be", "\n"),
    "old mac": ("utf-8", "\r"),
}


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("name", ["opencv.yml", "opencv.xml", "kalibr", "zed", "oak", "middlebury"])
def test_encoding_and_line_ends_do_not_matter(tmp_path, name, encoding):
    path = FORMATS[name](tmp_path, RECTIFIED)
    expected = Rig.read(path).geometry(SIZE)
    codec, line_end = ENCODINGS[encoding]
    path.write_bytes(path.read_text().replace("\n", line_end).encode(codec))
    if encoding == "mark":
        assert path.read_bytes().startswith(codecs.BOM_UTF8)
    assert Rig.read(path).geometry(SIZE) == expected


@pytest.mark.parametrize("name", ["middlebury", "kitti", "zed"])
def test_decimal_commas(tmp_path, name):
    path = FORMATS[name](tmp_path, RECTIFIED)
    expected = Rig.read(path).geometry(SIZE)
    path.write_text(path.read_text().replace(".", ","))
    assert Rig.read(path).geometry(SIZE) == expected


def test_commas_between_numbers(tmp_path):
    path = files.middlebury(tmp_path, RECTIFIED)
    expected = Rig.read(path).geometry(SIZE)
    path.write_text(path.read_text().replace(" 0 ", ", 0, "))
    assert Rig.read(path).geometry(SIZE) == expected


@pytest.mark.parametrize(
    "names",
    [
        "M1 D1 M2 D2 R T R1 P2 Q",
        "K1 D1 K2 D2 R T R1 P2 Q",
        "K0 D0 K1 D1 R T R0 P1 Q",
        "cameraMatrix1 distCoeffs1 cameraMatrix2 distCoeffs2 R T R1 P2 Q",
        "mtxL distL mtxR distR rot trans rectL projMatrixR Q",
        "camera_matrix_l dist_coeffs_l camera_matrix_r dist_coeffs_r R T R_l P_r Q",
        "left_camera_matrix left_distortion right_camera_matrix right_distortion R T R_left "
        "right_projection_matrix disparity_to_depth",
        "K_left D_left K_right D_right R_stereo T_stereo R_left P_right Q".replace("_stereo", ""),
        "mtx_left dist_left mtx_right dist_right rotation_matrix translation_vector rect_l P2 Q",
        "intrinsic1 distortion1 intrinsic2 distortion2 stereo_R stereo_T R1 P2 Q",
        "camL_K camL_D camR_K camR_D rmat tvec R1 P2 Q",
    ],
)
def test_names_of_calibration_scripts(names):
    canonical = ["K1", "D1", "K2", "D2", "R", "T", "R1", "P2", "Q"]
    assert find_names(dict.fromkeys(names.split())) == dict(
        zip(canonical, names.split(), strict=True)
    )


def test_intrinsics_and_extrinsics_in_two_files(tmp_path):
    values = files.opencv(RAW)
    lenses = {name: value for name, value in values.items() if name not in "RT"}
    paths = [
        files.storage(tmp_path / "in.yml", lenses),
        files.storage(tmp_path / "ex.yml", {"R": values["R"], "T": 1000 * values["T"]}),
    ]
    pair = Rig.read(paths, unit="mm").geometry(SIZE)
    np.testing.assert_allclose(pair.translation, RAW.translation)
    with pytest.raises(InputError, match=r"in\.yml, .*ex\.yml: a baseline of 120.* is implausible"):
        Rig.read(paths)
    with pytest.raises(InputError, match=r"in\.yml: .*no R, T in the file, only"):
        Rig.read(paths[0])


@pytest.mark.parametrize("name", ["kalibr", "euroc", "oak"])
def test_left_is_the_camera_that_stands_left(tmp_path, name):
    """The same two cameras, the right one first."""
    swapped = files.Cameras()
    swapped.translation = -swapped.translation
    rig = Rig.read(FORMATS[name](tmp_path, swapped))
    assert depth(rig.geometry(SIZE)) == pytest.approx(FOCAL * BASELINE / 20)
    assert any("left" in note for note in rig.notes)
    if name == "kalibr":
        with pytest.raises(InputError, match="are the cameras swapped"):
            Rig.read(tmp_path / "camchain.yaml", cameras=(0, 1))
        assert Rig.read(tmp_path / "camchain.yaml", cameras=(1, 0)).geometry(SIZE).doffs == 0


def test_two_files_of_ros_in_any_order(tmp_path):
    left, right = files.camera_info(tmp_path, RAW)
    for order in ((left, right), (right, left)):
        pair = Rig.read(order).geometry(SIZE)
        np.testing.assert_allclose(pair.translation, RAW.translation, atol=1e-6)
    assert "left.yaml is of the left camera" in Rig.read((right, left)).notes[0]
    rig = Rig.read((left, right))
    assert rig.notes == ("the pictures are taken for raw ones; --rectified says that they are",)
    assert isinstance(Rig.read((left, right), rectified=True).geometry(SIZE), Calibration)
    with pytest.raises(InputError, match="about rectified pictures alone"):
        Rig.read(right, rectified=False)
    assert depth(read_calibration(right)) == pytest.approx(depth(rig.calibration))


def test_a_chain_of_cameras(tmp_path):
    path = files.kalibr(tmp_path, RAW)
    chain = yaml.safe_load(path.read_text())
    chain["cam2"] = chain["cam1"]
    path.write_text(yaml.safe_dump(chain))
    with pytest.raises(InputError, match=r"has 3 camera.* cam0 cam1 cam2: .*--cameras 0 1"):
        Rig.read(path)
    pair = Rig.read(path, cameras=(0, 2)).geometry(SIZE)
    np.testing.assert_allclose(pair.rotation, RAW.rotation @ RAW.rotation, atol=1e-9)
    moved = RAW.rotation @ RAW.translation + RAW.translation
    np.testing.assert_allclose(pair.translation, moved, atol=1e-9)


def test_kitti_names_its_cameras(tmp_path):
    path = files.projections(tmp_path, ("P2", "P3"))
    text = path.read_text()
    path.write_text(text + text.replace("P2", "P0").replace("P3", "P1").replace("-42.0", "-21.0"))
    colour = Rig.read(path)
    assert "the grey ones are --cameras 0 1" in colour.notes[0]
    grey = Rig.read(path, cameras=(0, 1))
    assert grey.notes == ()
    assert grey.calibration.baseline == pytest.approx(colour.calibration.baseline / 2)
    path.write_text(text.replace("P3", "P5"))
    assert Rig.read(path).calibration.focal == FOCAL
    with pytest.raises(InputError, match=r"no P3 .*only of the cameras 2, 5: --cameras LEFT RIGHT"):
        Rig.read(path, cameras=(2, 3))


def test_kitti_tells_raw_and_rectified_pictures_apart_by_their_size(tmp_path):
    path = files.projections(tmp_path, ("P_rect_02", "P_rect_03"))
    camera, turned = " ".join(map(str, CAMERA.ravel())), " ".join(map(str, RAW.rotation.ravel()))
    text = path.read_text()
    for number in ("02", "03"):
        text += f"S_rect_{number}: 672 376\nS_{number}: 700 400\nK_{number}: {camera}\n"
        text += f"D_{number}: -0.1 0 0 0 0\nR_rect_{number}: {turned}\n"
    path.write_text(text)
    rig = Rig.read(path)
    assert isinstance(rig.geometry(SIZE), Calibration)
    assert isinstance(rig.geometry((700, 400)), CameraPair)
    assert rig.notes == ()
    view = np.zeros((400, 700), np.uint8)
    left, _, calibration = Rectifier(rig)(view, view)
    assert left.shape == (376, 672)
    assert depth(calibration) == pytest.approx(FOCAL * BASELINE / 20)


def test_a_zed_has_several_sizes(tmp_path):
    rig = Rig.read(files.zed(tmp_path, RAW))
    assert rig.geometry((1280, 720)).size == (1280, 720)
    with pytest.raises(InputError, match="of pictures of 672x376, 1280x720, these have 640x480"):
        rig.geometry((640, 480))


UNITS = {"opencv.yml": 1, "kalibr": 1, "kitti": 1, "ros": 1, "zed": 1000, "oak": 100}
UNITS |= {"middlebury": 1000, "realsense": 1, "euroc": 1, "realsense table": 1000}


@pytest.mark.parametrize("name", UNITS)
def test_the_unit_is_heard_in_every_format(tmp_path, name):
    path = FORMATS[name](tmp_path, RECTIFIED)
    own = {1: "m", 100: "cm", 1000: "mm"}[UNITS[name]]
    told = Rig.read(path, unit=own).geometry(SIZE)
    assert told == Rig.read(path).geometry(SIZE)
    for other in {"m": ["mm"], "cm": ["m"], "mm": ["m"]}[own]:
        with pytest.raises(InputError, match=rf"is implausible: .*--unit {own} \(0.12 m\).*--base"):
            Rig.read(path, unit=other)
    confirmed = Rig.read(path, unit="mm" if own == "m" else "m", baseline=0.2)
    assert confirmed.geometry(SIZE).baseline == 0.2
    with pytest.raises(InputError, match="a unit is one of m, cm, mm, got 'furlong'"):
        Rig.read(path, unit="furlong")
    with pytest.raises(InputError, match=r"baseline is 0.12 m, and --baseline says 0.2 m"):
        Rig.read(path, baseline=0.2)


BAD = {
    "R of another scale": ({"R": 2 * RAW.rotation}, "R is no rotation"),
    "R mirrored": ({"R": RAW.rotation * [1, -1, 1]}, "R is no rotation but a reflection"),
    "R zero": ({"R": np.zeros((3, 3))}, "R is no rotation"),
    "R not finite": ({"R": np.full((3, 3), np.nan)}, "R must be finite"),
    "R of another shape": ({"R": np.eye(4)}, "R must hold 3 x 3 numbers"),
    "K transposed": ({"M1": CAMERA.T}, "transposed, as MATLAB has it"),
    "K scaled": ({"M2": 2 * CAMERA}, "last row of K must be 0 0 1"),
    "K negative": ({"M2": CAMERA * [[1], [-1], [1]]}, "fy must be positive"),
    "K not finite": ({"M1": CAMERA * np.nan}, "K must be finite"),
    "another size": ({"M1": CAMERA * [[3], [3], [1]]}, "principal point .* is outside"),
    "millimetres": ({"M1": np.array([[3.6, 0, 336], [0, 3.6, 188], [0, 0, 1]])}, "in pixels"),
    "T zero": ({"T": np.zeros(3)}, "T must not be zero"),
    "T not finite": ({"T": np.array([np.inf, 0, 0])}, "must be finite"),
    "T up": ({"T": np.array([0, -0.12, 0])}, "one above the other"),
    "T swapped": ({"T": np.array([0.12, 0, 0])}, "are the cameras swapped"),
    **{
        f"{count} coefficients": ({"D1": np.full(count, 0.01)}, f"coefficients.* got {count}:")
        for count in (1, 2, 3, 6, 7, 13, 16)
    },
    "D not finite": ({"D2": np.full(5, np.nan)}, "distortion must be finite"),
}


@pytest.mark.parametrize("what", BAD)
def test_what_no_camera_has_is_refused(tmp_path, what):
    changes, message = BAD[what]
    path = files.storage(tmp_path / "rig.yml", files.opencv(RAW) | changes)
    with pytest.raises(InputError, match=rf"rig\.yml: .*{message}"):
        Rig.read(path)


def test_settings_of_orb_slam(tmp_path):
    path = files.orb_slam3(tmp_path, RECTIFIED)
    text = path.read_text()
    path.write_text(text.replace("PinHole", "Rectified").partition("Stereo")[0] + "Stereo.b: 0.12")
    expected = Rig.read(files.middlebury(tmp_path, RECTIFIED)).geometry(SIZE)
    assert Rig.read(path).geometry(SIZE) == expected
    path.write_text(text.replace("PinHole", "Omni"))
    with pytest.raises(InputError, match=r"Camera\.type is one of PinHole, .* got 'Omni'"):
        Rig.read(path)
    r1, r2, p1, p2 = RAW.rectification()
    sides = {"K": CAMERA, "D": RAW.five, "width": SIZE[0], "height": SIZE[1]}
    left, right = ({"R": r, "P": p} | sides for r, p in ((r1, p1), (r2, p2)))
    values = {f"LEFT.{name}": value for name, value in left.items()}
    values |= {f"RIGHT.{name}": value for name, value in right.items()}
    np.savez(tmp_path / "slam2.npz", **values)
    with pytest.raises(InputError, match="672x376, these have 1344x752"):
        Rig.read(tmp_path / "slam2.npz").geometry((1344, 752))
    np.savez(tmp_path / "slam2.npz", **values | {"RIGHT.width": 9})
    with pytest.raises(InputError, match=r"\(672, 376\) \(left\) and \(9, 376\) \(right\)"):
        Rig.read(tmp_path / "slam2.npz")


def test_cropped_views_may_not_show_their_principal_point(tmp_path):
    path = files.middlebury(tmp_path, RECTIFIED)
    text = path.read_text().replace(f" {files.CY};", " -40;")
    path.write_text(text.replace("height=376", "height=200"))
    assert Rig.read(path).geometry((672, 200)).cy == -40
    path.write_text("\n".join(line for line in text.splitlines() if "dth" not in line))
    with pytest.raises(InputError, match=r"principal point \(336, -40\) is outside"):
        Rig.read(path).geometry((672, 200))


def test_a_size_that_has_its_rows_first(tmp_path):
    path = files.plain_yaml(tmp_path, RAW)
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | {"image_size": [376, 672]}))
    with pytest.raises(InputError, match=r"376x672, these have 672x376 .*: write the width first"):
        Rig.read(path).geometry(SIZE)


@pytest.mark.parametrize("count", [0, 5, 8, 12, 14])
def test_numbers_of_coefficients_that_the_model_has(tmp_path, count):
    coefficients = np.full(count, 1e-3)
    values = files.opencv(RAW) | {"D1": coefficients, "D2": coefficients}
    path = tmp_path / "rig.npz"
    np.savez(path, **values)
    calibration = Rectifier(Rig.read(path)).calibration(SIZE)
    assert calibration.baseline == pytest.approx(np.linalg.norm(RAW.translation))


def test_the_files_own_rectification_counts(tmp_path):
    r1, r2, p1, p2 = RAW.rectification()
    own = {"R1": r1, "R2": r2, "P1": p1, "P2": p2}
    rig = Rig.read(files.storage(tmp_path / "all.yml", files.opencv(RAW) | own))
    assert Rectifier(rig).calibration(SIZE).focal == pytest.approx(p1[0, 0])
    assert Rectifier(rig, whole=True).calibration(SIZE).focal != pytest.approx(p1[0, 0])
    other = own | {"P2": p2 * [1, 1, 1, 2]}
    with pytest.raises(InputError, match=r"baseline is 0\.12.* m and P2 says 0\.24"):
        Rig.read(files.storage(tmp_path / "all.yml", files.opencv(RAW) | other))


def test_a_file_of_another_kind(tmp_path):
    for content in (b"", b"\x89PNG\r\n\x1a\n\0\0", b"\xff" * 100, b"PK\x03\x04broken", b"[1, 2]"):
        path = tmp_path / "file"
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"file: .*calibration"):
            Rig.read(path)
    with pytest.raises(FileNotFoundError):
        Rig.read(tmp_path / "none.yml")
    deep = tmp_path / "deep.json"
    deep.write_text('{"K1": ' + "[" * 100_000 + "]" * 100_000 + "}")
    with pytest.raises(InputError, match=r"deep\.json"):
        Rig.read(deep)


ANGLES = st.tuples(*[st.floats(-0.2, 0.2)] * 3)
OFFSETS = st.tuples(*[st.floats(-0.02, 0.02)] * 2)
LENSES = st.tuples(*[st.floats(-0.1, 0.1)] * 4)


@settings(max_examples=25, deadline=None)
@given(angles=ANGLES, offset=OFFSETS, lens=LENSES, name=st.sampled_from([*files.RAW_FORMATS]))
def test_whatever_is_written_is_read_again(tmp_path_factory, angles, offset, lens, name):
    cameras = files.Cameras(angles, offset, lens)
    rig = Rig.read(FORMATS[name](tmp_path_factory.mktemp("rig"), cameras))
    pair = rig.geometry(SIZE)
    if not isinstance(pair, CameraPair):  # all drawn zeros
        assert abs(np.array([*angles, *offset, *lens])).max() < 1e-5
        return
    np.testing.assert_allclose(pair.rotation, cameras.rotation, atol=1e-6)
    np.testing.assert_allclose(pair.translation, cameras.translation, atol=1e-6)
    np.testing.assert_allclose(pair.left.distortion[:4], cameras.distortion, atol=1e-12)


def test_a_rotation_vector_is_a_rotation(tmp_path):
    path = files.storage(tmp_path / "rig.yml", files.opencv(RAW) | {"R": RAW.vector})
    np.testing.assert_allclose(Rig.read(path).geometry(SIZE).rotation, cv2.Rodrigues(RAW.vector)[0])
