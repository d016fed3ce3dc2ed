//! Reads CARMEN logs (`.log`, `.clf`, also as `.gz` or `.bz2`). They appear like a ROS recording of the same
//! robot, with the topics `/scan`, `/odom` and `/tf_static`.

mod geometry;
mod line;
mod reader;
mod reorder;
mod survey;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use portolan_geometry::Time;

use crate::text::TextFile;
use crate::{MessageReader, Recording, RecordingError, TopicInfo};
use line::{LaserKind, Line, Pose2d, parse_line};
use reader::CarmenReader;
use survey::{Clock, Survey};

/// Which of the two times of a line is its stamp.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TimeColumn {
    /// When the message was sent.
    #[default]
    Ipc,
    /// When the logger wrote it, seconds since the start of the log.
    Logger,
}

/// How to read a CARMEN log.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CarmenOptions {
    /// The column of the stamps. A column whose time never changes is replaced by the other one.
    pub time_column: TimeColumn,
}

/// One scanner of the log that becomes a topic.
#[derive(Clone, Debug)]
struct Scanner {
    kind: LaserKind,
    topic: Arc<str>,
    frame: Arc<str>,
    /// Pose of the scanner on the robot; none if the log does not give it.
    mounting: Option<Pose2d>,
    count: u64,
}

/// Where odometry is read from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum OdometrySource {
    /// `ODOM` lines.
    OwnLines,
    /// Lines of this scanner, in logs without `ODOM` lines.
    Scans(LaserKind),
}

/// How lines become messages; fixed after the first pass over the log.
#[derive(Debug)]
struct Layout {
    survey: Survey,
    clock: Clock,
    scanners: Vec<Scanner>,
    odometry: Option<OdometrySource>,
    /// Messages keep the order of the lines, because the stamps are not reliable.
    in_order_of_lines: bool,
    first_time: Time,
}

/// A CARMEN log.
pub struct CarmenLog {
    file: TextFile,
    layout: Arc<Layout>,
    time_range: (Time, Time),
}

/// Whether a text begins like a CARMEN log.
pub fn looks_like_carmen(prefix: &[u8]) -> bool {
    prefix.split(|b| *b == b'\n').take(2000).any(|line| {
        line.starts_with(b"# CARMEN Logfile")
            || line.starts_with(b"# message_name [message contents] ipc_timestamp")
            || matches!(parse_line(line, false), Line::Odometry { .. } | Line::Laser { .. })
    })
}

impl CarmenLog {
    /// Opens a log and reads it once. Fails if it has neither scans nor odometry.
    pub fn open(path: &Path, options: CarmenOptions) -> Result<Self, RecordingError> {
        Self::of(TextFile::open(path)?, options)
    }

    pub(crate) fn of(file: TextFile, options: CarmenOptions) -> Result<Self, RecordingError> {
        let survey = Survey::of(&file)?;
        let clock = survey.clock(&options);
        let Some(time_range) = survey.time_range(clock) else {
            let detail = match survey.is_empty() {
                true => {
                    "it has no complete FLASER, RLASER, ROBOTLASER, RAWLASER or ODOM line as CARMEN logs have"
                }
                false => {
                    "no line of this CARMEN log has a possible time (seconds since 1970, or since its start)"
                }
            };
            let (path, detail) = (file.path().to_owned(), detail.to_owned());
            return Err(RecordingError::UnknownFormat { path, detail });
        };
        let scanners = scanners(&survey);
        let in_order_of_lines = survey.has_disturbed_stamps(clock);
        let with_scans = scanners.iter().map(|s| s.kind).find(|k| !matches!(k, LaserKind::Raw(_)));
        let odometry = match with_scans {
            // The odometry in the line of a scan belongs to that scan, even if its stamp is wrong.
            Some(kind) if in_order_of_lines || survey.odometry_lines == 0 => {
                Some(OdometrySource::Scans(kind))
            }
            _ if survey.odometry_lines > 0 => Some(OdometrySource::OwnLines),
            _ => None,
        };
        let layout =
            Layout { survey, clock, scanners, odometry, in_order_of_lines, first_time: time_range.0 };
        Ok(Self { file, layout: Arc::new(layout), time_range })
    }
}

/// Chooses one source for each scanner: the newer and richer format where a log has both.
fn scanners(survey: &Survey) -> Vec<Scanner> {
    let mut by_number: BTreeMap<u8, LaserKind> = BTreeMap::new();
    for kind in survey.kinds() {
        let (number, rank) = rank(kind);
        let entry = by_number.entry(number).or_insert(kind);
        if rank < self::rank(*entry).1 {
            *entry = kind;
        }
    }
    let scanner = |(number, kind): (u8, LaserKind)| {
        let (topic, frame) = match number {
            1 => ("/scan".to_owned(), "laser".to_owned()),
            2 => ("/rear_scan".to_owned(), "rear_laser".to_owned()),
            n => (format!("/scan_{n}"), format!("laser_{n}")),
        };
        let mounting = survey.mounting(kind);
        Scanner { kind, topic: topic.into(), frame: frame.into(), mounting, count: survey.scans(kind) }
    };
    by_number.into_iter().map(scanner).collect()
}

/// Number of the scanner, and the rank of the format of its lines (the lowest is the best).
fn rank(kind: LaserKind) -> (u8, u8) {
    match kind {
        LaserKind::Front => (1, 1),
        LaserKind::Rear => (2, 1),
        LaserKind::Robot(n) => (n, 0),
        LaserKind::Raw(n) => (n, 2),
    }
}

impl Layout {
    fn topics(&self) -> Vec<TopicInfo> {
        let info = |topic: &str, type_name: &str, count| TopicInfo {
            topic: topic.into(),
            type_name: type_name.into(),
            count: Some(count),
        };
        let mut topics: Vec<TopicInfo> =
            self.scanners.iter().map(|s| info(&s.topic, "sensor_msgs/LaserScan", s.count)).collect();
        match self.odometry {
            Some(OdometrySource::OwnLines) => {
                topics.push(info("/odom", "nav_msgs/Odometry", self.survey.odometry_lines));
            }
            Some(OdometrySource::Scans(kind)) => {
                topics.push(info("/odom", "nav_msgs/Odometry", self.survey.scans(kind)));
            }
            None => {}
        }
        if self.scanners.iter().any(|s| s.mounting.is_some()) {
            topics.push(info("/tf_static", "tf2_msgs/TFMessage", 1));
        }
        topics.sort_by(|a, b| a.topic.cmp(&b.topic));
        topics
    }
}

impl Recording for CarmenLog {
    fn format(&self) -> String {
        format!("CARMEN log{}", self.file.compression_name())
    }

    fn topics(&self) -> Vec<TopicInfo> {
        self.layout.topics()
    }

    fn time_range(&self) -> Option<(Time, Time)> {
        Some(self.time_range)
    }

    fn size_bytes(&self) -> u64 {
        self.file.size_bytes()
    }

    fn read(&self, wanted: &dyn Fn(&TopicInfo) -> bool) -> Result<Box<dyn MessageReader>, RecordingError> {
        Ok(Box::new(CarmenReader::new(&self.file, self.layout.clone(), wanted)?))
    }
}
