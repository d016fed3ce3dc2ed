//! What each kind of message becomes.

use portolan_geometry::{Duration, Time};
use portolan_recording::{
    Imu, LandmarkList, Message, NavSatFix, Odometry, PointCloud2, PoseStamped, RecordedMessage, TfMessage,
};
use portolan_sensor::{FixedFramePoseData, Measurement};

use super::{Ingestion, ODOMETRY, Role, Sensor, TimesByAzimuth};
use crate::azimuth_time::{self, TimedTurn};
use crate::clock::Stamp;
use crate::convert::{self, Frames, ImuFault};
use crate::laser::{ScanFaults, points_of_echoes, points_of_laser_scan};
use crate::plan::ImuScale;
use crate::point_cloud2::{CloudFaults, CloudLayout};
use crate::point_time::PointTime;
use crate::timed_points::TimedPoints;

const EVENED: &str = "stamps come in bursts or go back; times follow from the order of arrival and the usual rate (--stamps as-is keeps stamps)";

impl TimesByAzimuth {
    /// The turn of a cloud with this stamp.
    fn at(&mut self, stamp: Time) -> TimedTurn {
        let smooth = self.clock.smooth(stamp);
        TimedTurn {
            stamp: if self.keeps_stamps { stamp } else { smooth },
            seconds: self.clock.period(),
            meaning: self.meaning,
            turn: self.turn,
        }
    }
}

impl Ingestion {
    pub(super) fn take_message(&mut self, sensor: &mut Sensor, message: &RecordedMessage) {
        if !self.samplers[sensor.sampler].pulse() {
            return;
        }
        let Some(header) = message.message.header() else { return };
        let Some(stamp) = self.stamp(sensor, header.stamp, message.log_time) else { return };
        if sensor.even_stamps.holds(stamp, message) {
            self.take_evened(sensor, false);
        } else {
            self.convert(sensor, message, stamp);
        }
    }

    /// Takes messages of a sensor whose stamps are made even, as far as their times are known by now.
    pub(super) fn take_evened(&mut self, sensor: &mut Sensor, at_end: bool) {
        while let Some((message, stamp, time)) = sensor.even_stamps.pop(at_end) {
            self.repaired(&sensor.topic, EVENED, 1);
            self.stamp_correction = stamp - time;
            self.convert(sensor, &message, time);
            self.stamp_correction = Duration::ZERO;
        }
    }

    fn convert(&mut self, sensor: &mut Sensor, message: &RecordedMessage, stamp: Time) {
        let Some(header) = message.message.header() else { return };
        match (&mut sensor.role, &message.message) {
            (Role::Range { directions, .. }, Message::LaserScan(scan)) => {
                let (points, faults) = points_of_laser_scan(stamp, scan, self.with_intensities, directions);
                self.count_scan_faults(&sensor.topic, faults);
                self.give_subdivided(sensor, points, &header.frame_id);
            }
            (Role::Range { directions, .. }, Message::MultiEchoLaserScan(scan)) => {
                let (points, faults) = points_of_echoes(stamp, scan, self.with_intensities, directions);
                self.count_scan_faults(&sensor.topic, faults);
                self.give_subdivided(sensor, points, &header.frame_id);
            }
            (Role::Range { point_time, by_azimuth, .. }, Message::PointCloud2(cloud)) => {
                let point_time = *point_time;
                let turn = by_azimuth.as_mut().map(|turns| turns.at(stamp));
                self.take_cloud(sensor, stamp, cloud, point_time, turn);
            }
            (Role::Imu { scale }, Message::Imu(imu)) => {
                let scale = *scale;
                self.take_imu(sensor, stamp, imu, scale);
            }
            (Role::Odometry, Message::Odometry(odometry)) => self.take_odometry(sensor, stamp, odometry),
            (Role::NavSat, Message::NavSatFix(fix)) => self.take_fix(sensor, stamp, fix),
            (Role::FixedFramePose, Message::PoseStamped(pose)) => self.take_fixed_pose(sensor, stamp, pose),
            (Role::Landmarks, Message::LandmarkList(list)) => self.take_landmarks(sensor, stamp, list),
            _ => self.lost(&sensor.topic, "messages of another type than before were left out", 1),
        }
    }

    /// The stamp to use, if the message can be used.
    fn stamp(&mut self, sensor: &mut Sensor, stamp: Time, log_time: Time) -> Option<Time> {
        match sensor.clock.judge(stamp, log_time) {
            Stamp::Good(stamp) => Some(stamp),
            Stamp::Unset(stamp) => {
                self.repaired(&sensor.topic, "messages without a stamp got the time of recording", 1);
                Some(stamp)
            }
            Stamp::ClockSet(stamp) => {
                let what = "the clock jumped; stamps after that were shifted to go on as before";
                self.repaired(&sensor.topic, what, 1);
                Some(stamp)
            }
            Stamp::Jump => {
                let what = "messages whose stamp jumps away from the time of recording by more than 10 s were left out";
                self.lost(&sensor.topic, what, 1);
                None
            }
        }
    }

    fn give_subdivided(&mut self, sensor: &mut Sensor, points: TimedPoints, frame: &str) {
        if self.subdivisions > 1 && points.is_instant() {
            let what = "scans whose points all have the same time were not subdivided";
            self.repaired(&sensor.topic, what, 1);
            self.give_points(sensor, points, frame);
            return;
        }
        for piece in points.subdivide(self.subdivisions) {
            self.give_points(sensor, piece, frame);
        }
    }

    fn give_points(&mut self, sensor: &mut Sensor, points: TimedPoints, frame: &str) {
        if points.points.is_empty() {
            self.repaired(&sensor.topic, "messages without a single distance gave nothing", 1);
            return;
        }
        let time = points.time;
        let Some(pose) = self.tracking_from(&sensor.topic, frame, time) else { return };
        if self.is_later(&mut sensor.order, &sensor.topic, time) {
            if self.stamp_correction != Duration::ZERO {
                self.recorded_times.insert(time, time + self.stamp_correction);
            }
            let data = convert::range_data(points, &pose);
            self.ready.push((sensor.id.clone(), Measurement::Range(data)));
        }
    }

    fn take_cloud(
        &mut self,
        sensor: &mut Sensor,
        stamp: Time,
        cloud: &PointCloud2,
        point_time: Option<PointTime>,
        turn: Option<TimedTurn>,
    ) {
        let layout = match CloudLayout::of(cloud) {
            Ok(layout) => layout,
            Err(error) => return self.lost(&sensor.topic, &error.to_string(), 1),
        };
        let point_time = point_time.filter(|_| layout.has_time());
        let (mut points, faults) = layout.points(stamp, cloud, point_time, self.with_intensities);
        if let (None, Some(turn)) = (point_time, turn) {
            azimuth_time::assign(&mut points, &turn);
        }
        let CloudFaults { not_finite, far_time, zero, missing } = faults;
        self.repaired(
            &sensor.topic,
            "points that are not a number or beyond 1,000 km were left out",
            not_finite,
        );
        let what = "points whose time lies far outside their cloud were left out";
        self.repaired(&sensor.topic, what, far_time);
        self.repaired(&sensor.topic, "points at (0, 0, 0) were left out as no return", zero);
        self.lost(&sensor.topic, "points that clouds promise and do not have are missing", missing);
        self.give_points(sensor, points, &cloud.header.frame_id);
    }

    fn take_imu(&mut self, sensor: &mut Sensor, stamp: Time, message: &Imu, scale: ImuScale) {
        let Some(pose) = self.tracking_from(&sensor.topic, &message.header.frame_id, stamp) else { return };
        match convert::imu(stamp, message, scale, &pose) {
            Err(ImuFault::NotFinite) => {
                self.lost(&sensor.topic, "samples that are not a number were left out", 1)
            }
            Err(ImuFault::Impossible) => {
                let what = "samples beyond what an IMU can measure (80 rad/s, 400 m/s²) were left out";
                self.lost(&sensor.topic, what, 1);
            }
            Err(ImuFault::Partial) => {
                let what = "samples that say they lack acceleration or angular velocity were left out";
                self.lost(&sensor.topic, what, 1);
            }
            Ok(data) => {
                if self.is_later(&mut sensor.order, &sensor.topic, stamp) {
                    self.ready.push((sensor.id.clone(), Measurement::Imu(data)));
                }
            }
        }
    }

    fn take_odometry(&mut self, sensor: &mut Sensor, stamp: Time, message: &Odometry) {
        let Some((odom_from_child, normalised)) = convert::pose_of(&message.pose) else {
            return self.lost(&sensor.topic, "invalid poses were left out", 1);
        };
        self.repaired(&sensor.topic, "quaternions of a wrong length were normalised", u64::from(normalised));
        let Some(tracking_from_child) = self.tracking_from(&sensor.topic, &message.child_frame_id, stamp)
        else {
            return;
        };
        if self.is_later(&mut sensor.order, &sensor.topic, stamp) {
            let data = convert::odometry(stamp, odom_from_child, &tracking_from_child);
            self.ready.push((sensor.id.clone(), Measurement::Odometry(data)));
        }
    }

    pub(super) fn take_transforms(&mut self, transforms: &TfMessage) {
        let Some(mut odometry) = self.transform_odometry.take() else { return };
        for transform in &transforms.transforms {
            let is_odometry = *transform.header.frame_id.trim_start_matches('/') == *odometry.parent
                && *transform.child_frame_id.trim_start_matches('/') == *odometry.child;
            if !is_odometry || transforms.is_static || !self.samplers[ODOMETRY].pulse() {
                continue;
            }
            let time = transform.header.stamp;
            // Invalid ones were counted when they were kept out of the tree.
            let Some((odom_from_child, _)) = convert::pose_of(&transform.transform) else { continue };
            let Some(tracking_from_child) = self.tracking_from("/tf", &odometry.child, time) else {
                continue;
            };
            if self.is_later(&mut odometry.order, "/tf", time) {
                let data = convert::odometry(time, odom_from_child, &tracking_from_child);
                self.ready.push((odometry.id.clone(), Measurement::Odometry(data)));
            }
        }
        self.transform_odometry = Some(odometry);
    }

    fn take_fix(&mut self, sensor: &mut Sensor, stamp: Time, message: &NavSatFix) {
        let Some(data) = self.fixes.convert(stamp, message) else {
            return self.lost(&sensor.topic, "fixes that are no place on Earth were left out", 1);
        };
        if self.is_later(&mut sensor.order, &sensor.topic, stamp) {
            self.ready.push((sensor.id.clone(), Measurement::FixedFramePose(data)));
        }
    }

    fn take_fixed_pose(&mut self, sensor: &mut Sensor, stamp: Time, message: &PoseStamped) {
        let Some((pose, normalised)) = convert::pose_of(&message.pose) else {
            return self.lost(&sensor.topic, "invalid poses were left out", 1);
        };
        self.repaired(&sensor.topic, "quaternions of a wrong length were normalised", u64::from(normalised));
        if self.is_later(&mut sensor.order, &sensor.topic, stamp) {
            let data = FixedFramePoseData { time: stamp, fixed_from_tracking: Some(pose) };
            self.ready.push((sensor.id.clone(), Measurement::FixedFramePose(data)));
        }
    }

    fn take_landmarks(&mut self, sensor: &mut Sensor, stamp: Time, message: &LandmarkList) {
        let frames = Frames { tree: &self.source.tree, tracking: &self.plan.tracking_frame };
        let pose = frames.tracking_from(&message.header.frame_id, stamp).ok();
        if pose.is_none() {
            let what = "landmarks without a transform are taken as seen from the tracking frame";
            self.repaired(&sensor.topic, what, 1);
        }
        let (data, invalid) = convert::landmarks(stamp, message, pose.as_ref());
        self.lost(&sensor.topic, "landmarks with an invalid pose or weight were left out", invalid);
        if self.is_later(&mut sensor.order, &sensor.topic, stamp) {
            self.ready.push((sensor.id.clone(), Measurement::Landmark(data)));
        }
    }

    fn count_scan_faults(&mut self, topic: &str, faults: ScanFaults) {
        if faults == ScanFaults::default() {
            return;
        }
        self.repaired(
            topic,
            "readings that are not a number were taken as nothing seen",
            faults.nan_readings,
        );
        self.repaired(topic, "readings below zero were left out", faults.negative_readings);
        self.repaired(topic, "readings beyond 1,000 km were left out", faults.huge_readings);
        let limits = "scans whose range_min and range_max make no sense were read without those limits";
        self.repaired(topic, limits, u64::from(faults.bad_limits));
        let increment =
            "scans whose angle_increment does not fit their angles were read as far as it makes sense";
        self.repaired(topic, increment, u64::from(faults.bad_increment));
        let time = "scans whose time_increment makes no sense were taken as measured at once";
        self.repaired(topic, time, u64::from(faults.bad_time_increment));
    }
}
