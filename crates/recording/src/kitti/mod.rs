//! Reads folders of the KITTI data set: raw drives (`…_sync`, `…_extract`) and sequences of the odometry
//! benchmark.
//!
//! Sweeps are files of x, y, z and reflectance (`f32`). A raw drive has the time at which each sweep began,
//! pointed ahead and ended. The head turns clockwise, starting at the rear, so the time of each point follows
//! from its azimuth. Sequences of the benchmark are already motion-compensated, with one time per sweep.
//! `oxts` gives GNSS fixes and IMU samples.

mod oxts;
mod times;

#[cfg(test)]
mod tests;

use std::collections::VecDeque;
use std::f64::consts::{PI, TAU};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use portolan_geometry::{Duration, Rigid3, Time};
use portolan_issue::{Issue, IssueKind, IssueLog};
use portolan_lidar_packets::{PacketPoint, SweepBuilder};

use crate::packets::cloud_of;
use crate::{
    Header, Message, MessageReader, Pose, RecordedMessage, Recording, RecordingError, TfMessage, TopicInfo,
    TransformStamped,
};

const POINTS: &str = "/velodyne_points";
const FIX: &str = "/oxts/fix";
const IMU: &str = "/oxts/imu";
const TRANSFORMS: &str = "/tf_static";
const LIDAR_FRAME: &str = "velodyne";
const INS_FRAME: &str = "imu_link";
/// Maximum size of a sweep file, bytes; longer files are not read.
const MAX_SWEEP_BYTES: u64 = 1 << 26;
/// Offset of the benchmark's clock, which counts from the start of a sequence.
const CLOCK_START: Time = Time::from_ros(1_000_000_000, 0);

/// One sweep: its file, its time, and its start and end time.
#[derive(Clone, Debug)]
struct Sweep {
    path: PathBuf,
    stamp: Time,
    start: Time,
    end: Time,
}

/// One reading of the INS.
#[derive(Clone, Debug)]
struct InsReading {
    path: PathBuf,
    time: Time,
}

/// A drive or sequence.
struct Kitti {
    folder: PathBuf,
    is_raw: bool,
    sweeps: Arc<[Sweep]>,
    ins: Arc<[InsReading]>,
    ins_from_lidar: Rigid3,
    size_bytes: u64,
    issues: Vec<Issue>,
}

/// Opens a folder of KITTI; none if the folder is not one.
pub(crate) fn open(folder: &Path) -> Result<Option<Box<dyn Recording>>, RecordingError> {
    let raw = folder.join("velodyne_points");
    let is_raw = raw.join("data").is_dir();
    let data = if is_raw { raw.join("data") } else { folder.join("velodyne") };
    if !data.is_dir() {
        return Ok(None);
    }
    let files = times::numbered_files(&data, "bin")?;
    if files.is_empty() {
        return Ok(None);
    }
    let mut issues = IssueLog::default();
    let sweeps = if is_raw {
        raw_sweeps(&raw, files, &mut issues)?
    } else {
        let stamps = times::seconds_file(&folder.join("times.txt"), CLOCK_START)?;
        times::paired(files, stamps, "sweeps", &mut issues)
            .map(|(path, time)| Sweep { path, stamp: time, start: time, end: time })
            .collect()
    };
    let mut ins = Vec::new();
    if is_raw && folder.join("oxts").join("data").is_dir() {
        let files = times::numbered_files(&folder.join("oxts").join("data"), "txt")?;
        let stamps = times::date_file(&folder.join("oxts").join("timestamps.txt"))?;
        ins = times::paired(files, stamps, "readings of oxts", &mut issues)
            .map(|(path, time)| InsReading { path, time })
            .collect();
        ins.sort_by_key(|reading| reading.time);
    }
    let mut sweeps: Vec<Sweep> = sweeps;
    sweeps.sort_by_key(|sweep| sweep.end);
    if sweeps.is_empty() {
        return Err(RecordingError::UnknownFormat {
            path: folder.to_owned(),
            detail: "it has sweeps of KITTI but no times for them; add velodyne_points/timestamps.txt or times.txt"
                .to_owned(),
        });
    }
    let size = |path: &Path| std::fs::metadata(path).map_or(0, |m| m.len());
    let size_bytes = sweeps.iter().map(|s| size(&s.path)).sum::<u64>() + 500 * ins.len() as u64;
    Ok(Some(Box::new(Kitti {
        folder: folder.to_owned(),
        is_raw,
        sweeps: sweeps.into(),
        ins: ins.into(),
        ins_from_lidar: oxts::ins_from_lidar(folder, &mut issues),
        size_bytes,
        issues: issues.list(),
    })))
}

fn raw_sweeps(raw: &Path, files: Vec<PathBuf>, issues: &mut IssueLog) -> Result<Vec<Sweep>, RecordingError> {
    let middle = times::date_file(&raw.join("timestamps.txt"))?;
    let start = times::date_file(&raw.join("timestamps_start.txt"))?;
    let end = times::date_file(&raw.join("timestamps_end.txt"))?;
    // Without start and end times, a sweep takes 0.1 s and its stamp is its middle.
    let half = Duration::from_seconds(0.05);
    let sweeps = times::paired(files, middle, "sweeps", issues).enumerate().map(|(i, (path, time))| {
        let number = times::number_of(&path).unwrap_or(i);
        let stamp_in = |list: &[Option<Time>]| list.get(number).copied().flatten();
        let (start, end) = (stamp_in(&start).unwrap_or(time - half), stamp_in(&end).unwrap_or(time + half));
        Sweep { path, stamp: time, start, end: end.max(start) }
    });
    Ok(sweeps.collect())
}

impl Recording for Kitti {
    fn format(&self) -> String {
        if self.is_raw { "KITTI raw drive".to_owned() } else { "KITTI odometry sequence".to_owned() }
    }

    fn topics(&self) -> Vec<TopicInfo> {
        let info = |topic: &str, type_name: &str, count: usize| TopicInfo {
            topic: topic.into(),
            type_name: type_name.into(),
            count: Some(count as u64),
        };
        let mut topics = Vec::new();
        if !self.ins.is_empty() {
            topics.push(info(FIX, "sensor_msgs/NavSatFix", self.ins.len()));
            topics.push(info(IMU, "sensor_msgs/Imu", self.ins.len()));
            topics.push(info(TRANSFORMS, "tf2_msgs/TFMessage", 1));
        }
        topics.push(info(POINTS, "sensor_msgs/PointCloud2", self.sweeps.len()));
        topics
    }

    fn time_range(&self) -> Option<(Time, Time)> {
        let times = || self.sweeps.iter().map(|s| s.end).chain(self.ins.iter().map(|i| i.time));
        Some((times().min()?, times().max()?))
    }

    fn size_bytes(&self) -> u64 {
        self.size_bytes
    }

    fn read(&self, wanted: &dyn Fn(&TopicInfo) -> bool) -> Result<Box<dyn MessageReader>, RecordingError> {
        let chosen: Vec<Arc<str>> =
            self.topics().into_iter().filter(|t| wanted(t)).map(|t| t.topic).collect();
        let topic = |name: &str| chosen.iter().find(|t| ***t == *name).cloned();
        let mut issues = IssueLog::default();
        issues.merge(&self.issues);
        let mut pass = KittiPass {
            folder: self.folder.clone(),
            is_raw: self.is_raw,
            sweeps: if topic(POINTS).is_some() { self.sweeps.clone() } else { Arc::new([]) },
            ins: if topic(FIX).is_some() || topic(IMU).is_some() { self.ins.clone() } else { Arc::new([]) },
            next: (0, 0),
            topics: [topic(POINTS), topic(FIX), topic(IMU)],
            builder: SweepBuilder::default(),
            ready: VecDeque::new(),
            position_bytes: 0,
            issues,
        };
        if let (Some(topic), Some((first, _))) = (topic(TRANSFORMS), self.time_range()) {
            let message = transforms(first, &self.ins_from_lidar);
            pass.ready.push_back(RecordedMessage { topic, log_time: first, message });
        }
        Ok(Box::new(pass))
    }
}

fn transforms(stamp: Time, ins_from_lidar: &Rigid3) -> Message {
    let q = ins_from_lidar.rotation.quaternion();
    let transform = TransformStamped {
        header: Header { stamp, frame_id: INS_FRAME.into() },
        child_frame_id: LIDAR_FRAME.into(),
        transform: Pose {
            position: ins_from_lidar.translation.vector.into(),
            orientation_xyzw: [q.i, q.j, q.k, q.w],
        },
    };
    Message::Tf(TfMessage { is_static: true, transforms: vec![transform] })
}

/// One pass over a drive.
struct KittiPass {
    folder: PathBuf,
    is_raw: bool,
    sweeps: Arc<[Sweep]>,
    ins: Arc<[InsReading]>,
    /// Index of the next sweep and of the next INS reading.
    next: (usize, usize),
    /// Topics of points, fixes and IMU, where requested.
    topics: [Option<Arc<str>>; 3],
    builder: SweepBuilder,
    ready: VecDeque<RecordedMessage>,
    position_bytes: u64,
    issues: IssueLog,
}

impl KittiPass {
    /// One point of a file; in raw drives its time follows from its azimuth.
    fn point(&self, bytes: &[u8], sweep: &Sweep) -> PacketPoint {
        let value =
            |at: usize| bytes.get(at..at + 4).and_then(|b| b.try_into().ok()).map_or(0.0, f32::from_le_bytes);
        let [x, y, z] = [0, 4, 8].map(|at| f64::from(value(at)));
        // Clockwise from the rear: azimuth +π is the start of the sweep.
        let share = if self.is_raw { (PI - y.atan2(x)) / TAU } else { 0.0 };
        let share = if share.is_finite() { share } else { 0.0 };
        PacketPoint {
            position: [x, y, z],
            intensity: value(12),
            ring: 0,
            time: sweep.start + Duration::from_seconds(share * (sweep.end - sweep.start).seconds()),
        }
    }

    fn take_sweep(&mut self, sweep: &Sweep) {
        let Some(bytes) = self.file(&sweep.path, MAX_SWEEP_BYTES) else { return };
        if bytes.len() % 16 != 0 {
            self.issues.add(IssueKind::CutSweep);
        }
        let mut points: Vec<PacketPoint> = bytes.chunks_exact(16).map(|p| self.point(p, sweep)).collect();
        // Files are sorted by beam; sort the points in the order of measurement, as a lidar sends them.
        points.sort_by_key(|point| point.time);
        for point in &points {
            self.builder.push(point);
            if self.builder.is_full() {
                self.issues.add(IssueKind::HugeSweep);
                break;
            }
        }
        let Some(mut measured) = self.builder.take() else {
            self.issues.add(IssueKind::SweepWithoutPoints);
            return;
        };
        // The builder counts times from the first point; the stamp is when the lidar pointed ahead.
        let shift = (measured.stamp - sweep.stamp).seconds() as f32;
        for point in &mut measured.points {
            point.seconds += shift;
        }
        measured.stamp = sweep.stamp;
        let mut cloud = cloud_of(&measured, &LIDAR_FRAME.into());
        if !self.is_raw {
            cloud.fields.retain(|field| field.name != "time");
        }
        cloud.fields.retain(|field| field.name != "ring");
        if let Some(topic) = self.topics[0].clone() {
            let message = Message::PointCloud2(cloud);
            self.ready.push_back(RecordedMessage { topic, log_time: sweep.end, message });
        }
    }

    fn take_reading(&mut self, reading: &InsReading) {
        let Some(bytes) = self.file(&reading.path, 1 << 16) else { return };
        let Some((fix, imu)) = oxts::parse(&String::from_utf8_lossy(&bytes), reading.time, INS_FRAME) else {
            self.issues.add(IssueKind::UnreadableOxts);
            return;
        };
        let messages = [Message::NavSatFix(fix), Message::Imu(imu)];
        for (topic, message) in self.topics.iter().skip(1).zip(messages) {
            if let Some(topic) = topic.clone() {
                self.ready.push_back(RecordedMessage { topic, log_time: reading.time, message });
            }
        }
    }

    fn file(&mut self, path: &Path, longest: u64) -> Option<Vec<u8>> {
        let bytes = std::fs::metadata(path)
            .ok()
            .filter(|m| m.len() <= longest)
            .and_then(|_| std::fs::read(path).ok());
        match &bytes {
            Some(bytes) => self.position_bytes += bytes.len() as u64,
            None => {
                let folder = path.parent().and_then(|p| p.strip_prefix(&self.folder).ok());
                let folder = folder.map_or_else(String::new, |f| f.display().to_string());
                self.issues.add(Issue::new(IssueKind::UnreadableFiles).with("folder", folder));
            }
        }
        bytes
    }
}

impl MessageReader for KittiPass {
    fn next_message(&mut self) -> Result<Option<RecordedMessage>, RecordingError> {
        loop {
            if let Some(message) = self.ready.pop_front() {
                return Ok(Some(message));
            }
            let (sweep, reading) =
                (self.sweeps.get(self.next.0).cloned(), self.ins.get(self.next.1).cloned());
            match (sweep, reading) {
                (None, None) => return Ok(None),
                (Some(sweep), reading) if reading.as_ref().is_none_or(|r| sweep.end < r.time) => {
                    self.next.0 += 1;
                    self.take_sweep(&sweep);
                }
                (_, Some(reading)) => {
                    self.next.1 += 1;
                    self.take_reading(&reading);
                }
                (Some(_), None) => return Ok(None),
            }
        }
    }

    fn position_bytes(&self) -> u64 {
        self.position_bytes
    }

    fn issues(&self) -> Vec<Issue> {
        self.issues.list()
    }
}
