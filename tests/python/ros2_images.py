"""Writes a bag of ROS 2 with images, by the public packages `rosbags` and `opencv-python-headless`: python3 ros2_images.py FOLDER

One picture in several encodings, rows padded, and compressed; the same depths as integers and floats of either byte order, under two
lenses; and the points that OpenCV gives for these depths. What it holds is told in tests/ros2_images.rs.
"""

import sys

import cv2
import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
T = STORE.types
START_NS = 1_750_000_000_000_000_000
WIDTH, HEIGHT, FRAME = 16, 12, "camera"
K = np.array([[14.0, 0.0, 7.3], [0.0, 13.5, 5.9], [0.0, 0.0, 1.0]])
BROWN = np.array([-0.28, 0.09, 0.0011, -0.0007, -0.012])
RATIONAL = np.array([0.52, -0.26, 0.0006, -0.0002, 0.015, 0.39, -0.024, 0.0144])
FISHEYE = np.array([-0.0125, 0.0034, -0.0011, 0.0002])


def picture():
    """Red grows to the right, green to the top; a red patch at the left, a blue one below."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    rgb = np.stack([40 + 10 * x, 200 - 12 * y, 60 + 0 * x], axis=-1).astype(np.uint8)
    rgb[2:5, 1:5], rgb[8:11, 6:10] = (230, 30, 20), (20, 30, 230)
    return rgb


def depth_mm():
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    depth = (200 + 3 * x + 5 * y).astype(np.uint16)
    depth[0, :3] = 0
    return depth


def header(ns):
    return T["std_msgs/msg/Header"](stamp=T["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9), frame_id=FRAME)


def image(ns, encoding, rows, big_endian=False, padding=0):
    rows = np.ascontiguousarray(rows.astype(rows.dtype.newbyteorder(">" if big_endian else "<")))
    data = rows.view(np.uint8).reshape(HEIGHT, -1)
    data = np.pad(data, ((0, 0), (0, padding)), constant_values=0xA5)
    return T["sensor_msgs/msg/Image"](
        header=header(ns), height=HEIGHT, width=WIDTH, encoding=encoding, is_bigendian=int(big_endian), step=data.shape[1], data=data.ravel(),
    )


def info(ns, model, coefficients, **other):
    p = np.hstack([K, np.zeros((3, 1))])
    roi = T["sensor_msgs/msg/RegionOfInterest"](x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    fields = dict(height=HEIGHT, width=WIDTH, binning_x=0, binning_y=0, roi=roi) | other
    return T["sensor_msgs/msg/CameraInfo"](
        header=header(ns), distortion_model=model, d=np.array(coefficients), k=K.ravel(), r=np.eye(3).ravel(), p=p.ravel(), **fields,
    )


def points(ns, model, coefficients):
    """What OpenCV makes of the depths, in m."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    pixels = np.stack([x, y], axis=-1).reshape(-1, 1, 2).astype(np.float64)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-14)
    if model == "equidistant":
        rays = cv2.fisheye.undistortPoints(pixels, K, coefficients, criteria=criteria)
    else:
        # Versions before 5 have a function of its own for the criteria.
        iterated = getattr(cv2, "undistortPointsIter", None)
        rays = iterated(pixels, K, coefficients, np.eye(3), np.eye(3), criteria) if iterated else cv2.undistortPoints(pixels, K, coefficients, criteria=criteria)
    depth = depth_mm().reshape(-1).astype(np.float64)
    xyz = (np.hstack([rays.reshape(-1, 2), np.ones((len(depth), 1))]) * depth[:, None])[depth > 0] / 1000.0
    field, data = T["sensor_msgs/msg/PointField"], xyz.astype("<f8")
    return T["sensor_msgs/msg/PointCloud2"](
        header=header(ns), height=1, width=len(xyz), fields=[field(name=n, offset=8 * k, datatype=8, count=1) for k, n in enumerate("xyz")],
        is_bigendian=False, point_step=24, row_step=24 * len(xyz), data=data.view(np.uint8).ravel(), is_dense=True,
    )


def compressed(ns, how, ending, pixels):
    data = cv2.imencode(ending, pixels, [cv2.IMWRITE_JPEG_QUALITY, 95] if ending == ".jpg" else [])[1]
    return T["sensor_msgs/msg/CompressedImage"](header=header(ns), format=how, data=data.ravel())


def messages():
    rgb, depth = picture(), depth_mm()
    bgr, alpha = rgb[..., ::-1], np.full((HEIGHT, WIDTH, 1), 99, np.uint8)
    grey = rgb[..., 1].copy()
    yield "/rgb8", image(START_NS, "rgb8", rgb, padding=5)
    yield "/bgr8", image(START_NS, "bgr8", bgr)
    yield "/rgba8", image(START_NS, "rgba8", np.dstack([rgb, alpha]))
    yield "/bgra8", image(START_NS, "bgra8", np.dstack([bgr, alpha]), padding=8)
    yield "/mono8", image(START_NS, "mono8", grey, padding=1)
    yield "/mono16", image(START_NS, "mono16", grey.astype(np.uint16) * 257, big_endian=True)
    jpeg = compressed(START_NS, "rgb8; jpeg compressed bgr8", ".jpg", bgr)
    yield "/jpeg", jpeg
    yield "/jpeg_by_opencv", image(START_NS, "bgr8", cv2.imdecode(jpeg.data, cv2.IMREAD_COLOR))
    yield "/png", compressed(START_NS, "bgr8; png compressed bgr8", ".png", bgr)
    # OpenCV takes the first channel for blue: red and blue are exchanged in the file, as the format says.
    yield "/png_of_rgb", compressed(START_NS, "rgb8; png compressed rgb8", ".png", rgb)
    yield "/jpeg_of_grey", compressed(START_NS, "mono8; jpeg compressed ", ".jpg", grey)
    yield "/depth16", image(START_NS, "16UC1", depth, padding=2)
    yield "/depth16_big", image(START_NS, "16UC1", depth, big_endian=True)
    metres = depth.astype(np.float32) / 1000
    metres[depth == 0] = np.nan
    yield "/depth32", image(START_NS, "32FC1", metres)
    yield "/depth32_big", image(START_NS, "32FC1", metres, big_endian=True)
    for name, model, coefficients in [
        ("pinhole", "plumb_bob", np.zeros(5)), ("brown", "plumb_bob", BROWN), ("rational", "rational_polynomial", RATIONAL),
        ("fisheye", "equidistant", FISHEYE),
    ]:
        yield f"/{name}/info", info(START_NS, model, coefficients)
        yield f"/{name}/points", points(START_NS, model, coefficients)
    yield "/bayer", image(START_NS, "bayer_rggb8", grey)
    yield "/half/info", info(START_NS, "plumb_bob", np.zeros(5), width=WIDTH // 2, height=HEIGHT // 2)
    yield "/binned/info", info(START_NS, "plumb_bob", np.zeros(5), binning_x=2, binning_y=2)
    part = T["sensor_msgs/msg/RegionOfInterest"](x_offset=4, y_offset=0, height=HEIGHT, width=8, do_rectify=False)
    yield "/part/info", info(START_NS, "plumb_bob", np.zeros(5), roi=part)


def main(folder):
    writer = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        for topic, message in messages():
            connection = writer.add_connection(topic, message.__msgtype__, typestore=STORE)
            writer.write(connection, START_NS, STORE.serialize_cdr(message, connection.msgtype))


if __name__ == "__main__":
    main(sys.argv[1])
