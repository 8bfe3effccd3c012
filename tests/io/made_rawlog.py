"""Objects of MRPT as its classes write themselves: what a test reads back."""

import struct

import numpy as np

EPOCH = 11_644_473_600.0


def made(name, version, body, *, old=False, space=""):
    """An object; old: as before there was an end flag."""
    name = (space + name).encode()
    if old:
        return struct.pack("<I", len(name)) + name + struct.pack("<i", version) + body
    return bytes([0x80 | len(name)]) + name + bytes([version]) + body + b"\x88"


def stamp(t):
    return struct.pack("<Q", 0 if t is None else round((t + EPOCH) * 1e7))


def text(label):
    return struct.pack("<I", len(label)) + label.encode()


def pose2(pose, **how):
    return made("CPose2D", 1, struct.pack("<3d", *pose), **how)


def pose3(place, yaw=0.0, *, version=3, upside_down=False, pitch=0.0):
    """version 1: a matrix of 64 bits, 2: a quaternion (upright only), 3: a matrix row by row."""
    c, s = np.cos(yaw), np.sin(yaw)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    if upside_down:
        R = R @ np.diag([1.0, -1.0, -1.0])
    cp, sp = np.cos(pitch), np.sin(pitch)
    R = R @ np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    if version == 1:
        M = np.eye(4)
        M[:3, :3], M[:3, 3] = R, place
        body = made("CMatrixD", 0, struct.pack("<II", 4, 4) + M.astype("<f8").tobytes())
    elif version == 2:
        body = struct.pack("<7d", *place, np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2))
    else:
        body = struct.pack("<3d", *place) + R.astype("<f8").tobytes()
    return made("CPose3D", version, body)


def scan(
    t, ranges, *, version=8, aperture=np.pi, leftwards=True, most=20.0, valid=None, light=None, label="front", at=None
):
    n = len(ranges)
    body = struct.pack("<f?f", aperture, leftwards, most) + (at or pose3([0.2, 0.0, 0.3]))
    if version < 6:
        body += made("CMatrixF", 0, struct.pack("<II", 2, 2) + bytes(16))
    body += struct.pack("<I", n) + np.asarray(ranges, "<f4").tobytes()
    body += bytes([1] * n if valid is None else valid) + struct.pack("<f", 0.01) + stamp(t)
    if version >= 4:
        body += struct.pack("<f", 0.01)
    if version >= 5:
        body += text("front") + struct.pack("<d", 0.0)
    if version >= 7:
        body += struct.pack("<?", light is not None) + (b"" if light is None else np.asarray(light, "<i4").tobytes())
    if version >= 8:
        body += struct.pack("<d", 0.1)
    return made("CObservation2DRangeScan", version, body, space="mrpt::obs::")


def moved(increment, t, *, version=7):
    body = struct.pack("<i", 0) + pose2(increment) + struct.pack("<i6fi6f", 0, *[0.1] * 6, 100, *[0.1] * 6)
    body += struct.pack("<?3d", True, 0.5, 0.0, 0.1) if version >= 7 else struct.pack("<?2f", True, 0.5, 0.1)
    body += b"\0" if version >= 7 else struct.pack("<?2i", False, 0, 0)
    return made("CActionRobotMovement2D", version, body + stamp(t), space="mrpt::obs::")


def odometry(t, pose):
    body = pose2(pose) + text("ODOMETRY") + stamp(t) + struct.pack("<?2i", True, 10, 12) + b"\0"
    return made("CObservationOdometry", 2, body)


def ranges(t, rows, antenna=(0.16, 0.0, 0.3)):
    """rows: (beacon, distance)."""
    body = struct.pack("<3fI", 0.0, 100.0, 0.1, len(rows))
    for beacon, z in rows:
        body += made("CPoint3D", 1, struct.pack("<3d", *antenna)) + struct.pack("<fI", z, beacon)
    return made("CObservationBeaconRanges", 3, body + pose2([0.0, 0.0, 0.0]) + text("uwb") + stamp(t))


def frame(*seen):
    return made("CSensoryFrame", 2, struct.pack("<I", len(seen)) + b"".join(seen))


def actions(*done):
    return made("CActionCollection", 0, struct.pack("<I", len(done)) + b"".join(done))
