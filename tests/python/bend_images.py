"""Bends the pictures of a straight camera as a lens does, by OpenCV, and writes them as a bag of ROS 2 with JPEG images:

    python3 bend_images.py FOLDER STAMPED.ppm.. --k FX FY CX CY --model plumb_bob --d K1 K2 ..

A picture's name is its stamp in ns.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
T = STORE.types


def bent(straight, k, model, d):
    """Each pixel of the bent picture shows what the straight one shows along the same ray."""
    height, width = straight.shape[:2]
    y, x = np.mgrid[0:height, 0:width]
    pixels = np.stack([x, y], axis=-1).reshape(-1, 1, 2).astype(np.float64)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-14)
    undistort = cv2.fisheye.undistortPoints if model == "equidistant" else cv2.undistortPoints
    rays = undistort(pixels, k, d, criteria=criteria).reshape(height, width, 2)
    at = (rays * [k[0, 0], k[1, 1]] + [k[0, 2], k[1, 2]]).astype(np.float32)
    return cv2.remap(straight, at, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("folder")
    parser.add_argument("pictures", nargs="+", type=Path)
    parser.add_argument("--k", nargs=4, type=float)
    parser.add_argument("--model")
    parser.add_argument("--d", nargs="*", type=float)
    given = parser.parse_args()
    fx, fy, cx, cy = given.k
    k, d = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), np.array(given.d)
    with Writer(given.folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        images = writer.add_connection("/camera/color", "sensor_msgs/msg/CompressedImage", typestore=STORE)
        infos = writer.add_connection("/camera/info", "sensor_msgs/msg/CameraInfo", typestore=STORE)
        for path in given.pictures:
            straight = cv2.imread(str(path), cv2.IMREAD_COLOR)
            height, width = straight.shape[:2]
            ns = int(path.stem)
            stamp = T["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
            header = T["std_msgs/msg/Header"](stamp=stamp, frame_id="colour_optical_frame")
            data = cv2.imencode(".jpg", bent(straight, k, given.model, d), [cv2.IMWRITE_JPEG_QUALITY, 98])[1].ravel()
            image = T["sensor_msgs/msg/CompressedImage"](header=header, format="bgr8; jpeg compressed bgr8", data=data)
            roi = T["sensor_msgs/msg/RegionOfInterest"](x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
            info = T["sensor_msgs/msg/CameraInfo"](
                header=header, height=height, width=width, distortion_model=given.model, d=d, k=k.ravel(), r=np.eye(3).ravel(),
                p=np.hstack([k, np.zeros((3, 1))]).ravel(), binning_x=0, binning_y=0, roi=roi,
            )
            for connection, message in [(images, image), (infos, info)]:
                writer.write(connection, ns, STORE.serialize_cdr(message, connection.msgtype))


if __name__ == "__main__":
    main()
