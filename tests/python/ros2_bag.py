"""Writes a small bag of ROS 2 with the public package `rosbags`: python3 ros2_bag.py FOLDER

One cloud little-endian with padding and an extra field, one big-endian, one organised in rows; transforms, a static one
that is sent last, and a pose. What it holds is told in tests/ros2.rs.
"""

import sys

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
T = STORE.types
START_NS = 1_750_000_000_000_000_000


def header(ns, frame):
    stamp = T["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
    return T["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def cloud(ns, frame, data, height, fields, big_endian=False):
    field = T["sensor_msgs/msg/PointField"]
    bytes_ = np.frombuffer(data.tobytes(), dtype=np.uint8)
    return T["sensor_msgs/msg/PointCloud2"](
        header=header(ns, frame), height=height, width=data.size // height,
        fields=[field(name=n, offset=o, datatype=t, count=1) for n, o, t in fields],
        is_bigendian=big_endian, point_step=data.itemsize, row_step=bytes_.size // height, data=bytes_, is_dense=False,
    )


def transform(ns, parent, child, xyz, xyzw):
    vector, quaternion = T["geometry_msgs/msg/Vector3"](*xyz), T["geometry_msgs/msg/Quaternion"](*xyzw)
    return T["geometry_msgs/msg/TransformStamped"](
        header=header(ns, parent), child_frame_id=child,
        transform=T["geometry_msgs/msg/Transform"](translation=vector, rotation=quaternion),
    )


def points(order, n, offset):
    kind = np.dtype({"names": ["x", "y", "z", "intensity"], "formats": [order + "f4"] * 3 + [order + "u2"],
                     "offsets": [0, 4, 8, 12], "itemsize": 20})
    data = np.zeros(n, dtype=kind)
    k = np.arange(n)
    data["x"], data["y"], data["z"], data["intensity"] = k * 0.001 + offset, k * -0.002, 0.25, k
    return data


def main(folder):
    fields = [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("intensity", 12, 4)]
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        def topic(name, kind):
            return writer.add_connection(name, kind, typestore=STORE)

        def write(connection, ns, message):
            writer.write(connection, ns, STORE.serialize_cdr(message, connection.msgtype))

        scan = topic("/camera/points", "sensor_msgs/msg/PointCloud2")
        write(scan, START_NS, cloud(START_NS, "optical", points("<", 12, 0.5), 1, fields))
        write(scan, START_NS + 1, cloud(START_NS + 1, "optical", points(">", 12, 0.5), 1, fields, big_endian=True))
        organised = points("<", 12, 0.5)
        organised["z"][3] = np.nan
        write(scan, START_NS + 2, cloud(START_NS + 2, "optical", organised, 3, fields))
        tf, static = topic("/tf", "tf2_msgs/msg/TFMessage"), topic("/tf_static", "tf2_msgs/msg/TFMessage")
        message = T["tf2_msgs/msg/TFMessage"]
        moves = [transform(START_NS + 3, "map", "marker", (0.1, 0.2, 0.3), (0.0, 0.0, 0.6, 0.8)),
                 transform(START_NS + 3, "map", "unseen", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0))]
        write(tf, START_NS + 3, message(transforms=moves))
        single = topic("/marker", "geometry_msgs/msg/TransformStamped")
        write(single, START_NS + 4, moves[0])
        tip = topic("/tip", "geometry_msgs/msg/PoseStamped")
        pose = T["geometry_msgs/msg/Pose"](position=T["geometry_msgs/msg/Point"](0.4, 0.5, 0.6),
                                           orientation=T["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0))
        write(tip, START_NS + 5, T["geometry_msgs/msg/PoseStamped"](header=header(START_NS + 5, "map"), pose=pose))
        held = [transform(START_NS + 6, "base", "optical", (0.0, 0.0, 0.01), (0.0, 0.0, 0.0, 1.0))]
        write(static, START_NS + 6, message(transforms=held))


if __name__ == "__main__":
    main(sys.argv[1])
