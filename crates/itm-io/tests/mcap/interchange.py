"""MCAP files to and from other people's libraries: what the test `mcap` of this crate reads was written by this.

    python3 interchange.py write FOLDER      small recordings by the libraries of PyPI
    python3 interchange.py read FILE.mcap    reads a file of `itm convert` with them, checks it, and prints what it holds

Needs mcap, mcap-ros2-support, mcap-protobuf-support, foxglove-schemas-protobuf, numpy and pillow from PyPI; the files were
written with 1.6.0, 0.6.0, 0.6.0, 0.4.0, 2.4.6 and 13.0.0.
"""

import io
import math
import struct
import sys
from pathlib import Path

import numpy as np
from PIL import Image

W, H, FRAMES = 16, 12, 5
START_NS = 1_700_000_000_000_000_000
STEP_NS = 33_333_333

HEADER = """
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
IMAGE = """std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data""" + HEADER
COMPRESSED = """std_msgs/Header header
string format
uint8[] data""" + HEADER
INFO = """std_msgs/Header header
uint32 height
uint32 width
string distortion_model
float64[] d
float64[9] k
float64[9] r
float64[12] p
uint32 binning_x
uint32 binning_y
sensor_msgs/RegionOfInterest roi
================================================================================
MSG: sensor_msgs/RegionOfInterest
uint32 x_offset
uint32 y_offset
uint32 height
uint32 width
bool do_rectify""" + HEADER
GEOMETRY = """
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
================================================================================
MSG: geometry_msgs/Transform
geometry_msgs/Vector3 translation
geometry_msgs/Quaternion rotation
================================================================================
MSG: geometry_msgs/TransformStamped
std_msgs/Header header
string child_frame_id
geometry_msgs/Transform transform
================================================================================
MSG: geometry_msgs/PoseWithCovariance
geometry_msgs/Pose pose
float64[36] covariance
================================================================================
MSG: geometry_msgs/Twist
geometry_msgs/Vector3 linear
geometry_msgs/Vector3 angular
================================================================================
MSG: geometry_msgs/TwistWithCovariance
geometry_msgs/Twist twist
float64[36] covariance""" + HEADER
TF = "geometry_msgs/TransformStamped[] transforms" + GEOMETRY
ODOMETRY = """std_msgs/Header header
string child_frame_id
geometry_msgs/PoseWithCovariance pose
geometry_msgs/TwistWithCovariance twist""" + GEOMETRY
IMU = """std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance""" + GEOMETRY

K = [20.0, 0.0, 7.5, 0.0, 21.0, 5.5, 0.0, 0.0, 1.0]
R = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
P = [20.0, 0.0, 7.5, 0.0, 0.0, 21.0, 5.5, 0.0, 0.0, 0.0, 1.0, 0.0]
D = [0.01, -0.02, 0.001, 0.002, 0.003]


def depth(frame):
    y, x = np.mgrid[0:H, 0:W]
    values = (1000 + 10 * x + y + frame).astype("<u2")
    values[0, 0] = 0
    return values


def colour(frame):
    y, x = np.mgrid[0:H, 0:W]
    return np.stack([10 * x, 20 * y, np.full_like(x, 40 * frame)], axis=-1).astype(np.uint8)


def png(values):
    buffer = io.BytesIO()
    Image.fromarray(values).save(buffer, "png")
    return buffer.getvalue()


def time_of(frame):
    return START_NS + frame * STEP_NS


def header(ns, frame_id):
    return {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}, "frame_id": frame_id}


def vector(x, y, z):
    return {"x": x, "y": y, "z": z}


def quaternion(x, y, z, w):
    return {"x": x, "y": y, "z": z, "w": w}


def transform(ns, parent, child, translation, rotation):
    motion = {"translation": vector(*translation), "rotation": quaternion(*rotation)}
    return {"header": header(ns, parent), "child_frame_id": child, "transform": motion}


def info(ns, frame_id, model="plumb_bob", d=D):
    region = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
    return {"header": header(ns, frame_id), "height": H, "width": W, "distortion_model": model, "d": d, "k": K, "r": R,
            "p": P, "binning_x": 0, "binning_y": 0, "roi": region}


class Ros:
    """A file of ROS 2's messages."""

    def __init__(self, path, compression):
        from mcap.writer import CompressionType
        from mcap_ros2.writer import Writer

        self.file = open(path, "wb")
        self.writer = Writer(self.file, chunk_size=4096, compression=getattr(CompressionType, compression))
        self.schemas = {}

    def put(self, topic, name, definition, ns, message):
        if name not in self.schemas:
            self.schemas[name] = self.writer.register_msgdef(name, definition)
        # Logged some time after it was taken.
        self.writer.write_message(topic=topic, schema=self.schemas[name], message=message, log_time=ns + 5_000_000,
                                  publish_time=ns + 4_000_000)

    def finish(self):
        self.writer.finish()
        self.file.close()


def write_ros_raw(path):
    """Raw images with padded rows, cameras with lenses, poses from a tree of frames, a gyroscope."""
    ros = Ros(path, "ZSTD")
    half = math.sqrt(0.5)
    static = [
        transform(time_of(0), "base", "depth_optical", (0.1, 0.0, 0.0), (0.0, 0.0, half, half)),
        transform(time_of(0), "base", "color_optical", (0.15, 0.0, 0.0), (0.0, 0.0, half, half)),
    ]
    ros.put("/tf_static", "tf2_msgs/msg/TFMessage", TF, time_of(0), {"transforms": static})
    for frame in range(-1, FRAMES + 1):
        # Between frames, so that poses must be interpolated.
        ns = time_of(frame) + STEP_NS // 2
        moving = transform(ns, "map", "base", (0.1 * (frame + 0.5), 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        ros.put("/tf", "tf2_msgs/msg/TFMessage", TF, ns, {"transforms": [moving]})
    for frame in range(FRAMES):
        ns = time_of(frame)
        reading = {"header": header(ns - 1_000_000, "imu"), "orientation": quaternion(0.0, 0.0, 0.0, 1.0),
                   "orientation_covariance": [-1.0] + 8 * [0.0], "angular_velocity": vector(0.1 * frame, 0.2, 0.3),
                   "angular_velocity_covariance": 9 * [0.0], "linear_acceleration": vector(0.0, 0.0, 9.8),
                   "linear_acceleration_covariance": 9 * [0.0]}
        ros.put("/imu/data", "sensor_msgs/msg/Imu", IMU, ns, reading)
        step = 2 * W + 6
        rows = b"".join(row.tobytes() + b"\xff" * 6 for row in depth(frame))
        image = {"header": header(ns, "depth_optical"), "height": H, "width": W, "encoding": "16UC1", "is_bigendian": 0,
                 "step": step, "data": rows}
        ros.put("/camera/depth/image_raw", "sensor_msgs/msg/Image", IMAGE, ns, image)
        ros.put("/camera/depth/camera_info", "sensor_msgs/msg/CameraInfo", INFO, ns, info(ns, "depth_optical", d=[]))
        ns += 3_000_000
        image = {"header": header(ns, "color_optical"), "height": H, "width": W, "encoding": "bgr8", "is_bigendian": 0,
                 "step": 3 * W, "data": np.ascontiguousarray(colour(frame)[:, :, ::-1]).tobytes()}
        ros.put("/camera/color/image_raw", "sensor_msgs/msg/Image", IMAGE, ns, image)
        ros.put("/camera/color/camera_info", "sensor_msgs/msg/CameraInfo", INFO, ns, info(ns, "color_optical"))
    ros.finish()


def write_ros_compressed(path):
    """compressedDepth and PNG in chunks of lz4, poses as odometry of the camera."""
    ros = Ros(path, "LZ4")
    for frame in range(FRAMES):
        ns = time_of(frame)
        data = struct.pack("<iff", 0, 0.0, 0.0) + png(depth(frame))
        image = {"header": header(ns, "camera"), "format": "16UC1; compressedDepth png", "data": data}
        ros.put("/rgbd/depth/image/compressedDepth", "sensor_msgs/msg/CompressedImage", COMPRESSED, ns, image)
        image = {"header": header(ns, "camera"), "format": "rgb8; png compressed rgb8", "data": png(colour(frame))}
        ros.put("/rgbd/rgb/image/compressed", "sensor_msgs/msg/CompressedImage", COMPRESSED, ns, image)
        camera = info(ns, "camera", "rational_polynomial", D + [0.1, 0.05, 0.01])
        ros.put("/rgbd/camera_info", "sensor_msgs/msg/CameraInfo", INFO, ns, camera)
        pose = {"position": vector(0.0, 0.5 * frame, 0.0), "orientation": quaternion(0.0, 0.0, 0.0, 1.0)}
        twist = {"linear": vector(0.0, 0.0, 0.0), "angular": vector(0.0, 0.0, 0.0)}
        odometry = {"header": header(ns, "odom"), "child_frame_id": "camera",
                    "pose": {"pose": pose, "covariance": 36 * [0.0]}, "twist": {"twist": twist, "covariance": 36 * [0.0]}}
        ros.put("/odom", "nav_msgs/msg/Odometry", ODOMETRY, ns, odometry)
    ros.finish()


def write_foxglove(path):
    """Foxglove's messages without chunks, depth in metres."""
    from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
    from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
    from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
    from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
    from google.protobuf.timestamp_pb2 import Timestamp
    from mcap.writer import Writer
    from mcap_protobuf.schema import register_schema

    with open(path, "wb") as file:
        writer = Writer(file, use_chunking=False)
        writer.start()
        channels = {}
        for frame in range(FRAMES):
            ns = time_of(frame)
            stamp = Timestamp(seconds=ns // 10**9, nanos=ns % 10**9)

            def put(topic, message):
                if topic not in channels:
                    schema = register_schema(writer, type(message))
                    channels[topic] = writer.register_channel(topic, "protobuf", schema)
                writer.add_message(channels[topic], ns, message.SerializeToString(), ns)

            metres = (depth(frame).astype(np.float32) / 1000).astype("<f4")
            put("/depth", RawImage(timestamp=stamp, frame_id="depth", width=W, height=H, encoding="32FC1", step=4 * W,
                                   data=metres.tobytes()))
            put("/rgb", RawImage(timestamp=stamp, frame_id="rgb", width=W, height=H, encoding="rgb8", step=3 * W,
                                 data=colour(frame).tobytes()))
            put("/depth_calibration", CameraCalibration(timestamp=stamp, frame_id="depth", width=W, height=H,
                                                        distortion_model="plumb_bob", D=5 * [0.0], K=K, R=R, P=P))
            put("/rgb_calibration", CameraCalibration(timestamp=stamp, frame_id="rgb", width=W, height=H,
                                                      distortion_model="plumb_bob", D=D, K=K, R=R, P=P))
            between = FrameTransform(timestamp=stamp, parent_frame_id="rgb", child_frame_id="depth")
            between.translation.x, between.rotation.w = 0.05, 1.0
            put("/extrinsics", FrameTransforms(transforms=[between]))
            pose = PoseInFrame(timestamp=stamp, frame_id="world")
            pose.pose.position.z, pose.pose.orientation.w = 0.25 * frame, 1.0
            put("/pose", pose)
        writer.finish()


def read(path):
    """Reads all messages with the schemas that the file holds, and says how many there are of each."""
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory as Protobuf
    from mcap_ros2.decoder import DecoderFactory as Ros2

    counts, sizes = {}, {}
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[Protobuf(), Ros2()], validate_crcs=True)
        for schema, channel, _, message in reader.iter_decoded_messages():
            counts[channel.topic, schema.name] = counts.get((channel.topic, schema.name), 0) + 1
            if schema.name == "foxglove.RawImage":
                bytes_each = {"16UC1": 2, "32FC1": 4}[message.encoding]
                assert message.step == bytes_each * message.width
                assert len(message.data) == message.step * message.height
                sizes[channel.topic] = (message.width, message.height, message.encoding)
            elif schema.name == "foxglove.CompressedImage":
                with Image.open(io.BytesIO(message.data)) as image:
                    image.load()
                    sizes[channel.topic] = (*image.size, message.format)
            elif schema.name == "foxglove.CameraCalibration":
                assert len(message.K) == 9 and len(message.R) == 9 and len(message.P) == 12 and message.width > 0
            elif schema.name == "foxglove.PoseInFrame":
                q = message.pose.orientation
                assert abs(q.x**2 + q.y**2 + q.z**2 + q.w**2 - 1) < 1e-9 and message.frame_id == "world"
            elif schema.name == "sensor_msgs/msg/Imu":
                assert message.header.frame_id == "imu" and message.orientation_covariance[0] == -1
    assert sizes, "no images"
    for (topic, schema), count in sorted(counts.items()):
        print(topic, schema, count, *sizes.get(topic, ()))


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["write", folder]:
            write_ros_raw(Path(folder) / "ros2.mcap")
            write_ros_compressed(Path(folder) / "ros2_compressed.mcap")
            write_foxglove(Path(folder) / "foxglove.mcap")
        case ["read", file]:
            read(file)
        case _:
            sys.exit(__doc__)
