//! Converts each kind of message to measurements.

use std::sync::Arc;

use portolan_geometry::{Dimension, Duration, Quaternion, Time};
use portolan_issue::IssueKind;
use portolan_recording::{
    Imu, LandmarkList, Message, NavSatFix, Odometry, PointCloud2, PoseStamped, RecordedMessage, TfMessage,
};
use portolan_sensor::{FixedFramePoseData, Measurement};

use super::{Coordinates, Ingestion, Role, Sensor, TimesByAzimuth};
use crate::azimuth_time::{self, TimedTurn};
use crate::clock::Stamp;
use crate::convert::{self, Frames, ImuFault};
use crate::laser::{ScanCorrections, ScanFaults, points_of_echoes, points_of_laser_scan};
use crate::plan::{ImuScale, PlannedSensor, SensorPlan};
use crate::point_cloud2::{CloudFaults, CloudLayout};
use crate::point_time::PointTime;
use crate::timed_points::TimedPoints;

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
        if !self.samplers.of(&sensor.role).pulse() {
            return;
        }
        let Some(header) = message.message.header() else { return };
        let Some(stamp) = self.stamp(sensor, header.stamp, message.log_time) else { return };
        if sensor.even_stamps.holds(stamp, message) {
            self.take_evened(sensor, message.log_time);
        } else {
            self.convert(sensor, message, stamp);
        }
    }

    /// Processes messages of a sensor whose stamps are made even, if their times are determined at this time
    /// of recording.
    pub(super) fn take_evened(&mut self, sensor: &mut Sensor, now: Time) {
        while let Some((message, stamp, time)) = sensor.even_stamps.pop(now) {
            self.count(&sensor.topic, time, IssueKind::StampsEvened, 1);
            self.stamp_correction = stamp - time;
            self.convert(sensor, &message, time);
            self.stamp_correction = Duration::ZERO;
        }
    }

    fn convert(&mut self, sensor: &mut Sensor, message: &RecordedMessage, stamp: Time) {
        let Some(header) = message.message.header() else { return };
        match (&mut sensor.role, &message.message) {
            (Role::Range { scan_duration, smoothing, directions, .. }, Message::LaserScan(scan)) => {
                let (points, faults) = {
                    let how = ScanCorrections { duration: *scan_duration, smoothing: *smoothing };
                    points_of_laser_scan(stamp, (scan, how), self.with_intensities, directions)
                };
                self.count_scan_faults(&sensor.topic, stamp, faults);
                self.give_subdivided(sensor, points, &header.frame_id);
            }
            (Role::Range { scan_duration, directions, .. }, Message::MultiEchoLaserScan(scan)) => {
                let (points, faults) =
                    points_of_echoes(stamp, (scan, *scan_duration), self.with_intensities, directions);
                self.count_scan_faults(&sensor.topic, stamp, faults);
                self.give_subdivided(sensor, points, &header.frame_id);
            }
            (Role::Range { point_time, by_azimuth, coordinates, .. }, Message::PointCloud2(cloud)) => {
                let (point_time, coordinates) = (*point_time, *coordinates);
                let turn = by_azimuth.as_mut().map(|turns| turns.at(stamp));
                self.take_cloud(sensor, stamp, cloud, (point_time, turn), coordinates);
            }
            (Role::Imu { scale, correction, stuck }, Message::Imu(imu)) => {
                let (scale, correction) = (*scale, *correction);
                if stuck.is_stuck(stamp, imu) {
                    self.count(&sensor.topic, stamp, IssueKind::SampleStuck, 1);
                } else {
                    self.take_imu(sensor, stamp, imu, (scale, correction));
                }
            }
            (Role::Odometry { .. }, Message::Odometry(odometry)) => {
                self.take_odometry(sensor, stamp, odometry)
            }
            (Role::NavSat, Message::NavSatFix(fix)) => self.take_fix(sensor, stamp, fix),
            (Role::FixedFramePose, Message::PoseStamped(pose)) => self.take_fixed_pose(sensor, stamp, pose),
            (Role::Landmarks, Message::LandmarkList(list)) => self.take_landmarks(sensor, stamp, list),
            _ => self.count(&sensor.topic, stamp, IssueKind::OtherMessageType, 1),
        }
    }

    /// The stamp to use, if the message can be used.
    fn stamp(&mut self, sensor: &mut Sensor, stamp: Time, log_time: Time) -> Option<Time> {
        match sensor.clock.judge(stamp, log_time) {
            Stamp::Good(stamp) => Some(stamp),
            Stamp::Unset(stamp) => {
                self.count(&sensor.topic, log_time, IssueKind::MessageWithoutStamp, 1);
                Some(stamp)
            }
            Stamp::ClockSet(stamp) => {
                self.count(&sensor.topic, log_time, IssueKind::ClockJump, 1);
                Some(stamp)
            }
            Stamp::Jump => {
                self.count(&sensor.topic, log_time, IssueKind::StampFarFromRecording, 1);
                None
            }
        }
    }

    fn give_subdivided(&mut self, sensor: &mut Sensor, points: TimedPoints, frame: &str) {
        if self.subdivisions > 1 && points.is_instant() {
            self.count(&sensor.topic, points.time, IssueKind::ScanNotSubdivided, 1);
            self.give_points(sensor, points, frame);
            return;
        }
        for piece in points.subdivide(self.subdivisions) {
            self.give_points(sensor, piece, frame);
        }
    }

    /// Whether scans without returns are kept: with a single planar scanner, odometry determines the pose at
    /// their time.
    fn keeps_blind_scans(&self) -> bool {
        let SensorPlan { dimension, range, odometry, .. } = &self.plan;
        *dimension == Dimension::TwoD && range.len() == 1 && self.subdivisions == 1 && odometry.is_some()
    }

    fn give_points(&mut self, sensor: &mut Sensor, points: TimedPoints, frame: &str) {
        if points.points.is_empty() {
            self.count(&sensor.topic, points.time, IssueKind::NoDistance, 1);
            if !self.keeps_blind_scans() {
                return;
            }
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
        (point_time, turn): (Option<PointTime>, Option<TimedTurn>),
        coordinates: Coordinates,
    ) {
        let layout = match CloudLayout::of(cloud) {
            Ok(layout) => layout.with_length_unit(coordinates.length_unit),
            Err(error) => return self.count(&sensor.topic, stamp, error.kind(), 1),
        };
        let point_time = point_time.filter(|_| layout.has_time());
        let (mut points, faults) = layout.points(stamp, cloud, point_time, self.with_intensities);
        if let (None, Some(turn)) = (point_time, turn) {
            azimuth_time::assign(&mut points, &turn);
        }
        if let (Role::Range { sweep_stamps: Some(stamps), .. }, Some(first)) =
            (&mut sensor.role, points.points.first())
        {
            let begin = points.time + Duration::from_seconds(f64::from(first.time));
            if let Some(correction) = stamps.correction(stamp, begin, points.time) {
                points.time += correction;
                self.count(&sensor.topic, stamp, IssueKind::StampsEvened, 1);
            }
        }
        if let Some(raise) = coordinates.raise {
            points.points.iter_mut().for_each(|point| point.position = raise.point(&point.position));
        }
        let is_converted = coordinates.length_unit != 1.0;
        self.count(&sensor.topic, stamp, IssueKind::CloudInMillimetres, u64::from(is_converted));
        let CloudFaults { not_finite, far_time, zero, missing } = faults;
        self.count(&sensor.topic, stamp, IssueKind::PointNotFinite, not_finite);
        self.count(&sensor.topic, stamp, IssueKind::PointTimeFar, far_time);
        self.count(&sensor.topic, stamp, IssueKind::PointAtOrigin, zero);
        self.count(&sensor.topic, stamp, IssueKind::PointsMissing, missing);
        self.give_points(sensor, points, &cloud.header.frame_id);
    }

    fn take_imu(
        &mut self,
        sensor: &mut Sensor,
        stamp: Time,
        message: &Imu,
        (scale, correction): (ImuScale, Quaternion),
    ) {
        let Some(pose) = self.tracking_from(&sensor.topic, &message.header.frame_id, stamp) else { return };
        match convert::imu(stamp, message, scale, &(correction * pose.rotation)) {
            Err(ImuFault::NotFinite) => self.count(&sensor.topic, stamp, IssueKind::SampleNotFinite, 1),
            Err(ImuFault::Impossible) => {
                self.count(&sensor.topic, stamp, IssueKind::SampleImpossible, 1);
            }
            Err(ImuFault::Partial) => {
                self.count(&sensor.topic, stamp, IssueKind::SamplePartial, 1);
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
            return self.count(&sensor.topic, stamp, IssueKind::InvalidPose, 1);
        };
        self.count(&sensor.topic, stamp, IssueKind::QuaternionNormalised, u64::from(normalised));
        if let Role::Odometry { held: Some(held) } = &mut sensor.role
            && held.is_repeat(stamp, &odom_from_child)
        {
            return self.count(&sensor.topic, stamp, IssueKind::OdometryRepeats, 1);
        }
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
        let PlannedSensor { topic, frame: child, clock_shift, .. } = odometry.planned.clone();
        for transform in &transforms.transforms {
            let is_odometry = *transform.header.frame_id.trim_start_matches('/') == *odometry.parent
                && *transform.child_frame_id.trim_start_matches('/') == *child;
            if !is_odometry || transforms.is_static || !self.samplers.odometry.pulse() {
                continue;
            }
            let time = transform.header.stamp;
            // Invalid ones were counted when they were kept out of the tree.
            let Some((odom_from_child, _)) = convert::pose_of(&transform.transform) else { continue };
            if odometry.held.as_mut().is_some_and(|held| held.is_repeat(time, &odom_from_child)) {
                self.count(&topic, time, IssueKind::OdometryRepeats, 1);
                continue;
            }
            let Some(tracking_from_child) = self.tracking_from(&topic, &child, time) else {
                continue;
            };
            if self.is_later(&mut odometry.order, &topic, time) {
                let data = convert::odometry(time + clock_shift, odom_from_child, &tracking_from_child);
                self.ready.push((odometry.planned.sensor.clone(), Measurement::Odometry(data)));
            }
        }
        self.transform_odometry = Some(odometry);
    }

    fn take_fix(&mut self, sensor: &mut Sensor, stamp: Time, message: &NavSatFix) {
        let Some(data) = self.fixes.convert(stamp, message) else {
            return self.count(&sensor.topic, stamp, IssueKind::InvalidFix, 1);
        };
        if self.is_later(&mut sensor.order, &sensor.topic, stamp) {
            self.ready.push((sensor.id.clone(), Measurement::FixedFramePose(data)));
        }
    }

    fn take_fixed_pose(&mut self, sensor: &mut Sensor, stamp: Time, message: &PoseStamped) {
        let Some((pose, normalised)) = convert::pose_of(&message.pose) else {
            return self.count(&sensor.topic, stamp, IssueKind::InvalidPose, 1);
        };
        self.count(&sensor.topic, stamp, IssueKind::QuaternionNormalised, u64::from(normalised));
        if self.is_later(&mut sensor.order, &sensor.topic, stamp) {
            let data = FixedFramePoseData { time: stamp, fixed_from_tracking: Some(pose) };
            self.ready.push((sensor.id.clone(), Measurement::FixedFramePose(data)));
        }
    }

    fn take_landmarks(&mut self, sensor: &mut Sensor, stamp: Time, message: &LandmarkList) {
        let frames = Frames { tree: &self.source.tree, tracking: &self.plan.tracking_frame };
        let pose = frames.tracking_from(&message.header.frame_id, stamp).ok();
        if pose.is_none() {
            self.count(&sensor.topic, stamp, IssueKind::LandmarkWithoutTransform, 1);
        }
        let (data, invalid) = convert::landmarks(stamp, message, pose.as_ref());
        self.count(&sensor.topic, stamp, IssueKind::InvalidLandmark, invalid);
        if self.is_later(&mut sensor.order, &sensor.topic, stamp) {
            self.ready.push((sensor.id.clone(), Measurement::Landmark(data)));
        }
    }

    fn count_scan_faults(&mut self, topic: &Arc<str>, time: Time, faults: ScanFaults) {
        if faults == ScanFaults::default() {
            return;
        }
        self.count(topic, time, IssueKind::ReadingNotFinite, faults.nan_readings);
        self.count(topic, time, IssueKind::ReadingNegative, faults.negative_readings);
        self.count(topic, time, IssueKind::ReadingHuge, faults.huge_readings);
        self.count(topic, time, IssueKind::ScanLimitsWrong, u64::from(faults.bad_limits));
        self.count(topic, time, IssueKind::AngleIncrementWrong, u64::from(faults.bad_increment));
        self.count(topic, time, IssueKind::TimeIncrementWrong, u64::from(faults.bad_time_increment));
    }
}
