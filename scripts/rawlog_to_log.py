#!/usr/bin/env python3
"""rawlog_to_log.py IN.rawlog OUT.clf : planar scans and odometry of an MRPT rawlog as a CARMEN log.

Of rawlogs of actions and sensory frames: `CObservation2DRangeScan` of version 6 and the increments of odometry in
`CActionRobotMovement2D` of version 6, as robots recorded them in 2006 to 2012. Debian's package mrpt-common has two: a robot
that drives once around a building, "2006-01ENE-21-SENA_Telecom Faculty_one_loop_only.rawlog", and one that drives through rooms,
"uwb_ro-localization_demo.rawlog". Readings without a return become 81.83 m, as a SICK says it. Needs Python 3 alone.
"""
import gzip
import math
import re
import struct
import sys

NO_RETURN = 81.83
# Ticks of 100 ns since 1601 to seconds since 1970.
TICKS_PER_SECOND, EPOCH = 1e7, 11644473600
END = 0x88


class Objects:
    """Reads serialised objects: the length of a class's name plus 0x80, the name, a version, the members, an end mark."""

    def __init__(self, data, position):
        self.data, self.position = data, position

    def values(self, layout):
        found = struct.unpack_from("<" + layout, self.data, self.position)
        self.position += struct.calcsize("<" + layout)
        return found

    def begin(self, name):
        length = self.values("B")[0] & 0x7F
        found = self.data[self.position : self.position + length].decode()
        self.position += length
        if found != name:
            raise ValueError(f"{found} where a {name} is expected")
        return self.values("B")[0]

    def end(self):
        if self.values("B")[0] != END:
            raise ValueError("an object does not end where it should")

    def pose_2d(self):
        """x and y (m), yaw (rad)."""
        self.begin("CPose2D")
        pose = self.values("ddd")
        self.end()
        return pose

    def pose_3d(self):
        """x and y (m), yaw (rad) of a pose in space: a matrix, or a translation and a quaternion."""
        if self.begin("CPose3D") == 1:
            self.begin("CMatrixD")
            rows, columns = self.values("II")
            m = self.values(f"{rows * columns}d")
            self.end()
            pose = m[3], m[7], math.atan2(m[4], m[0])
        else:
            x, y, _, w, i, j, k = self.values("7d")
            pose = x, y, math.atan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))
        self.end()
        return pose

    def scan(self):
        """Seconds since 1970, readings from right to left (m), pose of the scanner on the robot."""
        version = self.begin("CObservation2DRangeScan")
        if version != 6:
            raise ValueError(f"a scan of version {version}; 6 is known")
        _, is_leftward, _ = self.values("fBf")
        pose = self.pose_3d()
        (count,) = self.values("I")
        ranges = self.values(f"{count}f")
        ranges = [r if valid else NO_RETURN for r, valid in zip(ranges, self.values(f"{count}B"))]
        _, ticks = self.values("fQ")
        return ticks / TICKS_PER_SECOND - EPOCH, ranges if is_leftward else ranges[::-1], pose


def compose(a, b):
    (x, y, yaw), (dx, dy, turn) = a, b
    c, s = math.cos(yaw), math.sin(yaw)
    return x + c * dx - s * dy, y + s * dx + c * dy, yaw + turn


def main():
    source, output = sys.argv[1:]
    data = gzip.open(source).read()
    starts = re.compile(rb"\x96CActionRobotMovement2D|\x97CObservation2DRangeScan")
    robot, first, count = (0.0, 0.0, 0.0), None, 0
    with open(output, "w") as log:
        for match in starts.finditer(data):
            objects = Objects(data, match.start())
            if b"Movement" in match.group():
                objects.begin("CActionRobotMovement2D")
                objects.values("I")
                robot = compose(robot, objects.pose_2d())
                continue
            seconds, ranges, mounted = objects.scan()
            first = seconds if first is None else first
            poses = " ".join(f"{v:.5f}" for v in (*compose(robot, mounted), *robot))
            readings = " ".join(f"{r:.3f}" for r in ranges)
            log.write(f"FLASER {len(ranges)} {readings} {poses} {seconds:.6f} nohost {seconds - first:.6f}\n")
            count += 1
    print(count, "scans")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main()
