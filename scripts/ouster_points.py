#!/usr/bin/env python3
"""ouster_points.py CONVERT CAPTURE.pcap ... : whether Portolan decodes captures of Ouster lidars as Ouster's own library does.

Prints for each sweep how many points both have, and how far the points of the library are from the nearest of Portolan's, median
and maximum in metres. CONVERT is the example program that writes a capture as a bag:
`cargo build --release -p portolan-recording --example convert_recording`. Captures of all kinds of sensors, with
their metadata, are in the source distribution of the Python package ouster-sdk (sdk/tests/pcaps). Needs numpy, scipy,
rosbags and ouster-sdk.
"""
import pathlib
import subprocess
import sys
import tempfile

import numpy as np
from ouster.sdk import core, open_source
from rosbags.highlevel import AnyReader
from scipy.spatial import cKDTree

TYPES = {2: "u1", 4: "<u2", 5: "<i4", 6: "<u4", 7: "<f4", 8: "<f8"}


def clouds(convert, capture):
    """Points of each sweep of a capture, in the frame of the sensor, metres, as Portolan reads them."""
    with tempfile.TemporaryDirectory() as folder:
        bag = pathlib.Path(folder) / "capture.bag"
        subprocess.run([convert, capture, bag], check=True, stdout=subprocess.DEVNULL)
        with AnyReader([bag]) as reader:
            for connection, _, raw in reader.messages():
                if connection.msgtype.endswith("PointCloud2"):
                    yield points(reader.deserialize(raw, connection.msgtype))


def points(cloud):
    layout = {"names": [f.name for f in cloud.fields], "formats": [TYPES[f.datatype] for f in cloud.fields],
              "offsets": [f.offset for f in cloud.fields], "itemsize": cloud.point_step}
    rows = np.frombuffer(bytes(cloud.data), np.dtype(layout))
    return np.column_stack([rows["x"], rows["y"], rows["z"]]).astype(float)


def library_sweeps(capture):
    """The same by Ouster's library, all returns."""
    for scans in open_source(str(capture)):
        for scan in scans:
            if scan is None:
                continue
            place = core.XYZLut(scan.sensor_info, use_extrinsics=False)
            returns = [scan.field(name) for name in scan.fields if name.startswith("RANGE")]
            yield scan.sensor_info, np.vstack([place(ranges)[ranges > 0] for ranges in returns])


def main():
    convert, captures = sys.argv[1], sys.argv[2:]
    for capture in captures:
        ours = [(cKDTree(sweep), len(sweep)) for sweep in clouds(convert, capture) if len(sweep)]
        for sensor, theirs in library_sweeps(capture):
            off, count = min(((tree.query(theirs)[0], count) for tree, count in ours), key=lambda pair: np.median(pair[0]))
            name = f"{pathlib.Path(capture).name} {sensor.prod_line} {sensor.format.udp_profile_lidar}"
            print(f"{name}: {len(theirs)} points, {count} here; median {np.median(off):.1e} m, at most {off.max():.1e} m")


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    main()
