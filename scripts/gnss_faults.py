#!/usr/bin/env python3
"""gnss_faults.py BAG TRUTH.tum OUT.bag HOW : satellite fixes from the truth, or wrong ones, for a ROS 1 bag.

HOW, joined by +:
    right         5 Hz, off by 0.5 m along each axis, anew each time, as the covariance says
    fine          off by 0.02 m
    drifting      off by 2 m, slowly changing over 30 s, with a covariance of 0.02 m
    multipath     off by 4 m in the middle third
    jumps         every tenth fix is 50 m off
    cold          the first five fixes are 300 m off
    null          fixes at 0, 0 now and then, the first three among them, with a status that says that they are fixes
    no-status     the same, with a status that says that they are none
    late          stamped 0.5 s late
    swapped       latitude and longitude exchanged
    frozen        the place of one third of the way is repeated until the end
    heights       heights off by 30 m
    metres        a place in metres in the fields of degrees
    silent        the covariance is zero, of unknown type
    antenna       1.2 m ahead of what the truth follows, 0.5 m to the left of it and 0.8 m above
    elsewhere     the place of another drive: turned by 90 degrees half way
Needs rosbags, numpy and scipy.
"""
import sys

import numpy as np
from bags import add_connections
from log_to_bag import STORE, make
from odometry_space import header
from rosbags.rosbag1 import Reader, Writer
from scipy.spatial.transform import Rotation, Slerp

ORIGIN = (48.2625, 11.6680, 480.0)
METRES_PER_DEGREE = 111_132.0


def slow(times, rng, sigma, seconds):
    knots = np.arange(times[0], times[-1] + seconds, seconds)
    return np.stack([np.interp(times, knots, rng.normal(0.0, sigma, len(knots))) for _ in range(3)], axis=1)


def fixes(truth, hows):
    """Times, east, north and up in metres, status, variance; and how they are written."""
    rng = np.random.default_rng(1)
    times = np.arange(truth[0, 0], truth[-1, 0], 0.2)
    places = np.stack([np.interp(times, truth[:, 0], truth[:, i]) for i in (1, 2, 3)], axis=1)
    if "antenna" in hows:
        turns = Slerp(truth[:, 0], Rotation.from_quat(truth[:, 4:8]))(times)
        places = places + turns.apply([1.2, 0.5, 0.8])
    count, third = len(times), len(times) // 3
    sigma = 0.02 if set(hows) & {"fine", "drifting"} else 0.5
    if "elsewhere" in hows:
        bend = places[count // 2]
        later = places[count // 2:] - bend
        places[count // 2:] = bend + np.stack([-later[:, 1], later[:, 0], later[:, 2]], axis=1)
    if "frozen" in hows:
        places[third:] = places[third]
    places = places + rng.normal(0.0, sigma, places.shape)
    if "drifting" in hows:
        places += slow(times, rng, 2.0, 30.0)
    if "multipath" in hows:
        places[third:2 * third] += [2.8, -2.8, 3.0]
    if "jumps" in hows:
        places[5::10] += [30.0, 40.0, 20.0]
    if "cold" in hows:
        places[:5] += [200.0, -220.0, 50.0]
    if "heights" in hows:
        places[:, 2] += rng.normal(0.0, 30.0, count)
    status, is_null = np.zeros(count, int), np.zeros(count, bool)
    if set(hows) & {"null", "no-status"}:
        is_null[:3] = is_null[20::40] = True
    if "no-status" in hows:
        status[is_null] = -1
    if "late" in hows:
        times = times + 0.5
    return times, places, status, is_null, sigma * sigma


def message(seconds, place, status, is_null, variance, hows):
    latitude = ORIGIN[0] + place[1] / METRES_PER_DEGREE
    longitude = ORIGIN[1] + place[0] / (METRES_PER_DEGREE * np.cos(np.radians(ORIGIN[0])))
    altitude = ORIGIN[2] + place[2]
    if "swapped" in hows:
        latitude, longitude = longitude, latitude
    if "metres" in hows:
        latitude, longitude, altitude = place[0], place[1], place[2]
    if is_null:
        latitude = longitude = altitude = 0.0
    covariance, kind = (np.zeros(9), 0) if "silent" in hows else (variance * np.eye(3).ravel(), 2)
    service = make("sensor_msgs/msg/NavSatStatus", status=int(status), service=1)
    return make(
        "sensor_msgs/msg/NavSatFix", header(seconds, "gps"), service, float(latitude), float(longitude), float(altitude),
        covariance, kind,
    )


def main():
    source, truth, output, how = sys.argv[1:]
    hows = how.split("+")
    times, *values, variance = fixes(np.loadtxt(truth), hows)
    with Reader(source) as reader, Writer(output) as writer:
        connections = add_connections(reader, writer)
        messages = [(time, connections[connection.id], raw) for connection, time, raw in reader.messages()]
        of_fixes = writer.add_connection("/fix", "sensor_msgs/msg/NavSatFix", typestore=STORE)
        for seconds, place, status, is_null in zip(times, *values):
            fix = message(seconds, place, status, is_null, variance, hows)
            messages.append((int(seconds * 1e9), of_fixes, STORE.serialize_ros1(fix, "sensor_msgs/msg/NavSatFix")))
        for time, connection, raw in sorted(messages, key=lambda message: message[0]):
            writer.write(connection, time, raw)


if __name__ == "__main__":
    main()
