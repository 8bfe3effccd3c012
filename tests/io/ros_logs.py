"""ROS recordings made for tests, in each of the three formats."""

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mapweave.io.bag import known_types

KINDS = {
    "scan": "sensor_msgs/msg/LaserScan",
    "odom": "nav_msgs/msg/Odometry",
    "tf": "tf2_msgs/msg/TFMessage",
    "cloud": "sensor_msgs/msg/PointCloud2",
    "echoes": "sensor_msgs/msg/MultiEchoLaserScan",
    "imu": "sensor_msgs/msg/Imu",
    "fix": "sensor_msgs/msg/NavSatFix",
    "place": "geometry_msgs/msg/PoseStamped",
    "unsure": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "objects": "vision_msgs/msg/Detection3DArray",
    "markers": "ros2_aruco_interfaces/msg/ArucoMarkers",
    "tags": "apriltag_msgs/msg/AprilTagDetectionArray",
    "text": "std_msgs/msg/String",
}
N = 90


class Recording:
    """Messages gathered as (time, topic, kind, message) and written in the format the file's suffix says."""

    def __init__(self, path):
        self.path, self.ros1 = path, path.suffix == ".bag"
        self.store = get_typestore(Stores.ROS1_NOETIC) if self.ros1 else known_types()
        if self.ros1:
            self.store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", KINDS["tf"]))
        self.rows = []

    def of(self, name, /, **values):
        return self.store.types[name](**values)

    def header(self, t, frame):
        ns = round(t * 1e9)
        stamp = self.of("builtin_interfaces/msg/Time", sec=ns // 10**9, nanosec=ns % 10**9)
        more = {"seq": 0} if self.ros1 else {}
        return self.of("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **more)

    def turn(self, roll, yaw):
        q = np.array([np.sin(roll / 2), 0, 0, np.cos(roll / 2)])
        z, w = np.sin(yaw / 2), np.cos(yaw / 2)
        x, y, z, w = w * q[0] - z * q[1], w * q[1] + z * q[0], w * q[2] + z * q[3], w * q[3] - z * q[2]
        return self.of("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def text(self, t, topic="/chatter"):
        self.rows.append((t, topic, "text", self.of(KINDS["text"], data="hello")))

    def scan(self, t, ranges, light=None, topic="/scan", frame="laser", at=None, angles=(-1.5, 1.5), far=10.0, dt=0.0):
        """dt: [s] from beam to beam, as its driver states it."""
        message = self.of(
            KINDS["scan"],
            header=self.header(t if at is None else at, frame),
            angle_min=angles[0],
            angle_max=angles[1],
            angle_increment=(angles[1] - angles[0]) / (len(ranges) - 1),
            time_increment=dt,
            scan_time=0.1,
            range_min=0.1,
            range_max=far,
            ranges=np.asarray(ranges, np.float32),
            intensities=np.asarray([] if light is None else light, np.float32),
        )
        self.rows.append((t, topic, "scan", message))

    def echoes(self, t, ranges, topic="/echoes", frame="laser"):
        """A scan whose every beam is a list of ranges."""
        echo = lambda values: self.of("sensor_msgs/msg/LaserEcho", echoes=np.asarray(values, np.float32))
        message = self.of(
            KINDS["echoes"],
            header=self.header(t, frame),
            angle_min=-1.5,
            angle_max=1.5,
            angle_increment=3.0 / (len(ranges) - 1),
            time_increment=0.0,
            scan_time=0.1,
            range_min=0.1,
            range_max=10.0,
            ranges=[echo(values) for values in ranges],
            intensities=[],
        )
        self.rows.append((t, topic, "echoes", message))

    def cloud(self, t, points, topic="/points", frame="lidar", *, names="xyz", big=False, **wrong):
        """Points (n, len(names)) as 32-bit numbers, an intensity where `names` ends in i; `wrong` replaces members."""
        data = np.ascontiguousarray(points, ">f4" if big else "<f4")
        called = ["intensity" if name == "i" else name for name in names]
        fields = [
            self.of("sensor_msgs/msg/PointField", name=name, offset=4 * k, datatype=7, count=1)
            for k, name in enumerate(called)
        ]
        values = {
            "height": 1,
            "width": len(data),
            "fields": fields,
            "is_bigendian": big,
            "point_step": 4 * len(fields),
            "row_step": data.nbytes,
            "data": data.reshape(-1).view(np.uint8),
            "is_dense": True,
        } | wrong
        self.rows.append((t, topic, "cloud", self.of(KINDS["cloud"], header=self.header(t, frame), **values)))

    def imu(self, t, rate, felt=(0.0, 0.0, 9.81), topic="/imu", frame="imu_link"):
        """Turn rate about the unit's z [rad/s] or over its axes, and acceleration felt [m/s^2], None: not told."""
        of, none = self.of, np.zeros(9)
        w = rate if np.ndim(rate) else (0.0, 0.0, rate)
        vector = lambda v: of("geometry_msgs/msg/Vector3", **dict(zip("xyz", map(float, v), strict=True)))
        message = of(
            KINDS["imu"],
            header=self.header(t, frame),
            orientation=self.turn(0, 0),
            orientation_covariance=none,
            angular_velocity=vector(w),
            angular_velocity_covariance=none,
            linear_acceleration=vector((0.0, 0.0, 0.0) if felt is None else felt),
            linear_acceleration_covariance=np.array([-1.0 if felt is None else 0.0, *none[1:]]),
        )
        self.rows.append((t, topic, "imu", message))

    def fix(self, t, place, sd=1.0, topic="/fix", frame="gps", *, status=0, cov=None):
        """Latitude, longitude [deg] and height [m]; sd: None where it is not known; cov: as it is."""
        of = self.of
        full = np.diag([sd or 0.0] * 3).ravel() ** 2 if cov is None else np.asarray(cov, float).ravel()
        message = of(
            KINDS["fix"],
            header=self.header(t, frame),
            status=of("sensor_msgs/msg/NavSatStatus", status=status, service=1),
            **dict(zip(("latitude", "longitude", "altitude"), map(float, place), strict=True)),
            position_covariance=full,
            position_covariance_type=0 if sd is None else 2,
        )
        self.rows.append((t, topic, "fix", message))

    def place(self, t, at, topic="/mocap/pose", frame="mocap", *, cov=None):
        """A pose by others, with its covariance (6, 6) where there is one."""
        pose = self.pose(at)
        if cov is not None:
            covariance = np.asarray(cov, float).ravel()
            pose = self.of("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=covariance)
        kind = "place" if cov is None else "unsure"
        self.rows.append((t, topic, kind, self.of(KINDS[kind], header=self.header(t, frame), pose=pose)))

    def pose(self, at):
        return self.of(
            "geometry_msgs/msg/Pose",
            position=self.of("geometry_msgs/msg/Point", **dict(zip("xyz", map(float, at), strict=True))),
            orientation=self.turn(0, 0),
        )

    def objects(self, t, seen, topic="/detections", frame="camera"):
        """Detections of vision_msgs: names and places (x, y, z) [m] in the camera's frame."""
        of = self.of
        size = of("geometry_msgs/msg/Vector3", x=0.2, y=0.2, z=0.2)
        detections = []
        for name, at in seen:
            pose = of("geometry_msgs/msg/PoseWithCovariance", pose=self.pose(at), covariance=np.zeros(36))
            what = of("vision_msgs/msg/ObjectHypothesis", class_id=name, score=0.9)
            result = of("vision_msgs/msg/ObjectHypothesisWithPose", hypothesis=what, pose=pose)
            box = of("vision_msgs/msg/BoundingBox3D", center=self.pose(at), size=size)
            detections.append(
                of("vision_msgs/msg/Detection3D", header=self.header(t, frame), results=[result], bbox=box, id="")
            )
        message = of(KINDS["objects"], header=self.header(t, frame), detections=detections)
        self.rows.append((t, topic, "objects", message))

    def markers(self, t, seen, topic="/aruco_markers", frame="camera"):
        """Markers of ros2_aruco: numbers and places (x, y, z) [m] in the camera's frame."""
        ids, poses = [int(name) for name, _ in seen], [self.pose(at) for _, at in seen]
        message = self.of(
            KINDS["markers"], header=self.header(t, frame), marker_ids=np.array(ids, np.int64), poses=poses
        )
        self.rows.append((t, topic, "markers", message))

    def tags(self, t, numbers, topic="/detections", frame="camera"):
        """Detections of apriltag_msgs, which tell corners in the image and no place."""
        of = self.of
        corner = of("apriltag_msgs/msg/Point", x=1.0, y=2.0)
        some = {"hamming": 0, "goodness": 1.0, "decision_margin": 50.0, "homography": np.eye(3).ravel()}
        detections = [
            of("apriltag_msgs/msg/AprilTagDetection", family="36h11", id=k, centre=corner, corners=[corner] * 4, **some)
            for k in numbers
        ]
        self.rows.append((t, topic, "tags", of(KINDS["tags"], header=self.header(t, frame), detections=detections)))

    def odom(self, t, x, topic="/odom", yaw=0.0, child="base_link", y=0.0):
        of = self.of
        zero = of("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
        pose = of(
            "geometry_msgs/msg/Pose",
            position=of("geometry_msgs/msg/Point", x=x, y=y, z=0.0),
            orientation=self.turn(0, yaw),
        )
        message = of(
            KINDS["odom"],
            header=self.header(t, "odom"),
            child_frame_id=child,
            pose=of("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36)),
            twist=of(
                "geometry_msgs/msg/TwistWithCovariance",
                twist=of("geometry_msgs/msg/Twist", linear=zero, angular=zero),
                covariance=np.zeros(36),
            ),
        )
        self.rows.append((t, topic, "odom", message))

    def tf(self, t, parent, child, x=0.0, y=0.0, yaw=0.0, roll=0.0, topic="/tf", z=0.2):
        of = self.of
        transform = of(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(t, parent),
            child_frame_id=child,
            transform=of(
                "geometry_msgs/msg/Transform",
                translation=of("geometry_msgs/msg/Vector3", x=x, y=y, z=z),
                rotation=self.turn(roll, yaw),
            ),
        )
        self.rows.append((t, topic, "tf", of(KINDS["tf"], transforms=[transform])))

    def write(self):
        if self.ros1:
            writer, serialize = Writer1(self.path), self.store.serialize_ros1
        else:
            plugin = StoragePlugin.MCAP if self.path.suffix == ".mcap" else StoragePlugin.SQLITE3
            folder = self.path.with_suffix("")
            writer, serialize = Writer2(folder, version=8, storage_plugin=plugin), self.store.serialize_cdr
        with writer:
            lines = {}
            for t, topic, kind, message in self.rows:
                if topic not in lines:
                    lines[topic] = writer.add_connection(topic, KINDS[kind], typestore=self.store)
                writer.write(lines[topic], round(t * 1e9), serialize(message, KINDS[kind]))
        if not self.ros1:
            next(folder.glob(f"*{self.path.suffix}")).rename(self.path)
        return self.path


def wall(k, n=N):
    return 2.0 + 0.01 * k + 0.3 * np.sin(np.linspace(0, 4, n))


def usual(path, n=30, light=True):
    """A robot that drives ahead at 1 m/s with a laser 0.2 m ahead, scans between odometry rows."""
    out = Recording(path)
    out.tf(9.9, "base_link", "laser", x=0.2, topic="/tf_static")
    for k in range(n):
        out.odom(10.0 + 0.1 * k, 0.1 * k)
        out.scan(10.05 + 0.1 * k, wall(k), np.arange(N) + k if light else None)
    return out


def driving(out, name, k, *, t=10.0, speed=1.0, base="base_link", laser="laser", odom="odom", scan="scan"):
    """Row k of a robot in namespace `name` that drives ahead: its odometry, then a scan of the wall."""
    space = f"/{name}" if name else ""
    out.odom(t + 0.1 * k, speed * 0.1 * k, topic=f"{space}/{odom}", child=base)
    out.scan(t + 0.05 + 0.1 * k, wall(k), topic=f"{space}/{scan}", frame=laser)
