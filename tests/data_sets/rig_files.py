"""Descriptions of one stereo camera in each format, by the formats' documented layouts."""

import json

import cv2
import numpy as np
import yaml

SIZE = (672, 376)
"""Width and height of the pictures: one of a ZED's."""

FOCAL, CX, CY, BASELINE = 350.0, 336.0, 188.0, 0.12
CAMERA = np.array([[FOCAL, 0, CX], [0, FOCAL, CY], [0, 0, 1]])


class Cameras:
    """Two cameras: the right one's pose and lens, and what rectifies them.

    Without arguments they are parallel and bend nothing: their pictures are rectified.
    """

    def __init__(self, rotation=(0, 0, 0), offset=(0, 0), distortion=(0, 0, 0, 0), model="pinhole"):
        self.vector = np.array(rotation, float)
        self.rotation = cv2.Rodrigues(self.vector)[0]
        self.translation = np.array([-BASELINE, *offset])
        self.distortion = np.array(distortion, float)  # k1 k2 p1 p2, or of a fisheye
        self.fisheye = model == "fisheye"

    @property
    def five(self):
        return self.distortion if self.fisheye else np.append(self.distortion, 0)

    @property
    def pose(self):
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, self.translation
        return matrix

    def rectification(self):
        """R1, R2, P1, P2."""
        return cv2.stereoRectify(
            *(CAMERA, np.zeros(5)) * 2, SIZE, self.rotation, self.translation[:, None], alpha=-1
        )[:4]


RECTIFIED = Cameras()
RAW = Cameras((0.01, -0.02, 0.015), (0.001, -0.002), (-0.1, 0.02, 0.001, -0.0005))
FISHEYE = Cameras((0.01, -0.02, 0.015), (0.001, -0.002), (0.02, -0.004, 0.001, 0), "fisheye")


def opencv(c):
    """Names of OpenCV's samples, and values."""
    pose = {"R": c.rotation, "T": c.translation[:, None]}
    return {"M1": CAMERA, "D1": c.five, "M2": CAMERA, "D2": c.five} | pose


def storage(path, values, flags=0):
    """Write with OpenCV's own writer, with what nobody needs: NaN, corners in two channels."""
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE | flags)
    file.write("rms", float("nan"))
    file.write("image_points", np.random.default_rng(0).random((6, 9, 2)).astype(np.float32))
    file.write("per_view_errors", np.array([[np.nan, np.inf]]))
    for name, value in values.items():
        file.write(name, value)
    file.write("image_width", SIZE[0])
    file.write("image_height", SIZE[1])
    file.release()
    return path


def lists(values):
    return {name: np.asarray(value).tolist() for name, value in values.items()}


def plain_yaml(folder, c):
    path = folder / "plain.yaml"
    path.write_text(yaml.safe_dump(lists(opencv(c)) | {"image_size": list(SIZE)}))
    return path


def plain_json(folder, c):
    path = folder / "plain.json"
    sides = {
        side: {"camera_matrix": CAMERA.tolist(), "dist_coeffs": c.five.tolist()}
        for side in ("left", "right")
    }
    pose = {"R": c.rotation.tolist(), "T": c.translation.tolist(), "error": float("nan")}
    path.write_text(json.dumps(sides | pose | {"width": SIZE[0], "height": SIZE[1]}))
    return path


def npz(folder, c):
    path = folder / "stereo.npz"
    lenses = {"cameraMatrixL": CAMERA, "distL": c.five, "cameraMatrixR": CAMERA, "distR": c.five}
    objects = np.array([{"a": 1}], dtype=object)
    np.savez(path, **lenses, rot=c.rotation, trans=c.translation, imageSize=SIZE, notes=objects)
    return path


def camera_info(folder, c):
    """What ROS's camera_calibration saves."""
    *rotations, left, right = c.rectification()
    paths = []
    for name, rotation, projection in zip(("left", "right"), rotations, (left, right), strict=True):
        matrices = {
            "camera_matrix": CAMERA,
            "distortion_coefficients": c.five[None],
            "rectification_matrix": rotation,
            "projection_matrix": projection,
        }
        values = {"image_width": SIZE[0], "image_height": SIZE[1], "camera_name": name}
        values["distortion_model"] = "equidistant" if c.fisheye else "plumb_bob"
        for key, matrix in matrices.items():
            rows, cols = matrix.shape
            values[key] = {"rows": rows, "cols": cols, "data": matrix.ravel().tolist()}
        paths.append(folder / f"{name}.yaml")
        paths[-1].write_text(yaml.safe_dump(values))
    return paths


def kalibr(folder, c):
    camera = {
        "camera_model": "pinhole",
        "distortion_model": "equidistant" if c.fisheye else "radtan",
        "distortion_coeffs": c.distortion.tolist(),
        "intrinsics": [FOCAL, FOCAL, CX, CY],
        "resolution": list(SIZE),
    }
    second = camera | {"T_cn_cnm1": c.pose.tolist(), "cam_overlaps": [0]}
    path = folder / "camchain.yaml"
    path.write_text(yaml.dump({"cam0": camera, "cam1": second}))
    return path


def euroc(folder, c, header=""):
    body = np.eye(4)  # of the left camera
    body[:3, :3], body[:3, 3] = cv2.Rodrigues(np.array([0.3, 0.2, 0.1]))[0], (1, 2, 3)
    paths = []
    for name, pose in (("cam0", body), ("cam1", body @ np.linalg.inv(c.pose))):
        values = {
            "sensor_type": "camera",
            "T_BS": {"cols": 4, "rows": 4, "data": pose.ravel().tolist()},
            "resolution": list(SIZE),
            "camera_model": "pinhole",
            "intrinsics": [FOCAL, FOCAL, CX, CY],
            "distortion_model": "equidistant" if c.fisheye else "radial-tangential",
            "distortion_coefficients": c.distortion.tolist(),
        }
        (folder / name).mkdir()
        paths.append(folder / name / "sensor.yaml")
        paths[-1].write_text(header + yaml.safe_dump(values))
    return paths


def zed(folder, c):
    k1, k2, p1, p2 = c.distortion
    camera = f"fx={FOCAL}\nfy={FOCAL}\ncx={CX}\ncy={CY}\nk1={k1}\nk2={k2}\np1={p1}\np2={p2}\nk3=0\n"
    larger = camera.replace(f"={CX}", f"={CX + 304}").replace(f"={CY}", f"={CY + 172}")
    rx, cv, rz = c.vector
    x, y, z = -1000 * c.translation
    path = folder / "SN1234.conf"
    path.write_text(
        f"[LEFT_CAM_HD]\n{larger}[RIGHT_CAM_HD]\n{larger}"
        f"[LEFT_CAM_VGA]\n{camera}\n[RIGHT_CAM_VGA]\n{camera}\n[STEREO]\nBaseline={x}\nTY={y}\n"
        f"TZ={z}\nCV_VGA={cv}\nRX_VGA={rx}\nRZ_VGA={rz}\nCV_HD={cv}\nRX_HD={rx}\nRZ_HD={rz}\n"
        "[MISC]\nSensor_ID=0\n"
    )
    return path


def oak(folder, c):
    """As depthai's eepromToJsonFile has it: left is socket 1, right 2, both in a chain to 0."""
    coefficients = np.zeros(14)
    coefficients[:4] = c.distortion
    to_colour = np.eye(4)  # of the right camera
    to_colour[0, 3] = 0.04

    def camera(pose, target):
        place = 100 * pose[:3, 3]
        return {
            "cameraType": int(c.fisheye),
            "distortionCoeff": coefficients.tolist(),
            "extrinsics": {
                "rotationMatrix": pose[:3, :3].tolist(),
                "specTranslation": {"x": -7.5, "y": 0.0, "z": 0.0},
                "toCameraSocket": target,
                "translation": dict(zip("xyz", place.tolist(), strict=True)),
            },
            "height": SIZE[1],
            "intrinsicMatrix": CAMERA.tolist(),
            "width": SIZE[0],
        }

    colour = camera(np.eye(4), -1)
    cameras = [[0, colour], [1, camera(c.pose, 2)], [2, camera(to_colour, 0)]]
    stereo = {"leftCameraSocket": 1, "rightCameraSocket": 2}
    path = folder / "eeprom.json"
    path.write_text(json.dumps({"cameraData": cameras, "stereoRectificationData": stereo}))
    return path


def realsense(folder, c):
    """Intrinsics as librealsense names them, and the way from infrared 1 to 2, column by column."""
    model = "kannala_brandt4" if c.fisheye else "brown_conrady"
    camera = {"width": SIZE[0], "height": SIZE[1], "ppx": CX, "ppy": CY, "fx": FOCAL, "fy": FOCAL}
    camera |= {"model": f"distortion.{model}", "coeffs": np.append(c.distortion, 0).tolist()}
    pose = {"rotation": c.rotation.T.ravel().tolist(), "translation": c.translation.tolist()}
    values = {"infrared1": camera, "infrared2": camera, "extrinsics": pose}
    path = folder / "realsense.json"
    path.write_text(json.dumps(values))
    return path


def named_numbers(folder, c):
    """Distortion as named numbers, beside the matrix of one camera and below that of the other."""
    lens = dict(zip(("k1", "k2", "p1", "p2"), c.distortion.tolist(), strict=True))
    matrix = {"fx": FOCAL, "fy": FOCAL, "cx": CX, "cy": CY}
    pose = {"rotation": c.rotation.T.ravel().tolist(), "translation": c.translation.tolist()}
    sides = {
        "left": matrix | lens,
        "right": {"projection_parameters": matrix, "distortion_parameters": lens},
    }
    path = folder / "named.json"
    path.write_text(json.dumps(sides | {"extrinsics": pose}))
    return path


def orb_slam3(folder, c):
    """Settings whose pose is that of camera 2 in the frame of camera 1."""
    names = ("k1", "k2", "k3", "k4") if c.fisheye else ("k1", "k2", "p1", "p2")
    camera = {"fx": FOCAL, "fy": FOCAL, "cx": CX, "cy": CY}
    camera |= dict(zip(names, c.distortion.tolist(), strict=True))
    lines = [f"Camera{n}.{name}: {value}" for n in (1, 2) for name, value in camera.items()]
    pose = np.linalg.inv(c.pose).ravel().tolist()
    path = folder / "slam.yaml"
    path.write_text(
        f'%YAML:1.0\n---\nCamera.type: "{"KannalaBrandt8" if c.fisheye else "PinHole"}"\n'
        + "\n".join(lines)
        + f"\nCamera.width: {SIZE[0]}\nCamera.height: {SIZE[1]}\nCamera.newWidth: 600\n"
        f"Stereo.T_c1_c2: !!opencv-matrix\n  rows: 4\n  cols: 4\n  dt: f\n  data: {pose}\n"
    )
    return path


def realsense_table(folder, c):
    table = {"baseline": "-120"}
    for index, factor in enumerate((2, 1)):
        values = {
            "fx": FOCAL,
            "fy": FOCAL,
            "ppx": CX,
            "ppy": CY,
            "width": SIZE[0],
            "height": SIZE[1],
        }
        table |= {f"rectified.{index}.{name}": str(factor * v) for name, v in values.items()}
    path = folder / "table.json"
    path.write_text(json.dumps(table))
    return path


def middlebury(folder, c):
    path = folder / "calib.txt"
    matrix = f"[{FOCAL} 0 {CX}; 0 {FOCAL} {CY}; 0 0 1]"
    path.write_text(
        f"cam0={matrix}\ncam1={matrix}\ndoffs=0\nbaseline=120.0\nwidth={SIZE[0]}\n"
        f"height={SIZE[1]}\nndisp=70\n"
    )
    return path


def projections(folder, names):
    path = folder / "calib_cam_to_cam.txt"
    row = f"{FOCAL} 0.0 {CX} {{}} 0.0 {FOCAL} {CY} 0.0 0.0 0.0 1.0 0.0"
    shifts = (0.0, -FOCAL * BASELINE)
    lines = [f"{name}: {row.format(s)}\n" for name, s in zip(names, shifts, strict=True)]
    path.write_text("calib_time: 09-Jan-2012 13:57:47\n" + "".join(lines))
    return path


OPENCV = {
    f"opencv.{ending}{' in base64' * bool(flags)}": (
        lambda folder, c, e=ending, f=flags: storage(folder / f"rig.{e}", opencv(c), f)
    )
    for ending in ("yml", "xml", "json")
    for flags in (0, cv2.FILE_STORAGE_BASE64)
}

RAW_FORMATS = OPENCV | {
    "plain yaml": plain_yaml,
    "plain json": plain_json,
    "npz": npz,
    "ros": camera_info,
    "kalibr": kalibr,
    "euroc": euroc,
    "kimera": lambda folder, c: euroc(folder, c, "%YAML:1.0\n"),
    "zed": zed,
    "oak": oak,
    "realsense": realsense,
    "named numbers": named_numbers,
    "orb-slam3": orb_slam3,
}
"""Formats that tell about raw pictures."""

RECTIFIED_FORMATS = {
    "realsense table": realsense_table,
    "middlebury": middlebury,
    "kitti": lambda folder, c: projections(folder, ("P_rect_02", "P_rect_03")),
    "kitti odometry": lambda folder, c: projections(folder, ("P2", "P3")),
    "kitti grey": lambda folder, c: projections(folder, ("P0", "P1")),
    "kitti 360": lambda folder, c: projections(folder, ("P_rect_00", "P_rect_01")),
    "driving stereo": lambda folder, c: projections(folder, ("P_rect_101", "P_rect_103")),
    "opencv projections": lambda folder, c: storage(
        folder / "p.yml", dict(zip(("P1", "P2"), c.rectification()[2:], strict=True))
    ),
}
"""Formats of rectified pictures alone."""
