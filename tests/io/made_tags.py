"""Landmark logs as a recording of what cameras told: detections with poses, the camera apart from the robot."""

import numpy as np

from mapweave.core import se2

from .ros_logs import Recording

CAMERA = np.array([0.05, 0.0, 0.1])  # T_robot_camera


def tag_bag(path, logs):
    """Every robot in its namespace: its commands as the poses they lead to, each sighting a detection."""
    out = Recording(path)
    for log in logs:
        name, pose = log.robot, np.zeros(3)
        x, y, yaw = CAMERA
        out.tf(logs[0].span[0] - 1.0, f"{name}/base", f"{name}/camera", x=x, y=y, yaw=yaw, topic=f"/{name}/tf_static")
        o, s = log.odometry, log.sightings
        for t, v, w, dt in zip(o.t, o.v, o.w, np.append(np.diff(o.t), 0.0), strict=True):
            out.odom(t, pose[0], y=pose[1], yaw=pose[2], topic=f"/{name}/odom", child=f"{name}/base")
            pose = se2.compose(pose, se2.exp(np.array([v * dt, 0.0, w * dt])))
        for k in range(len(s)):
            at = s.range[k] * np.array([[np.cos(s.bearing[k]), np.sin(s.bearing[k])]])
            x, y = se2.act(se2.inverse(CAMERA), at)[0]
            seen = [(s.ids[s.what[k]], (x, y, 0.3))]
            out.objects(s.t[k], seen, topic=f"/{name}/detections", frame=f"{name}/camera")
        if log.fixes is not None:
            out.tf(logs[0].span[0] - 1.0, f"{name}/base", f"{name}/gps", x=-0.3, y=0.1, topic=f"/{name}/tf_static")
            for t, place, cov in zip(log.fixes.t, log.fixes.place, log.fixes.cov, strict=True):
                out.fix(t, place, np.sqrt(cov[0, 0]), topic=f"/{name}/fix", frame=f"{name}/gps")
    out.rows.sort(key=lambda row: row[0])
    return out.write()
