//! Stores scans during mapping, so that pictures are drawn without reading the recording a second time.
//!
//! Stored are the points that local SLAM used: thinned out, but as measured, so that the final trajectory can
//! de-skew them. They are stored in a nameless file on disk, which disappears with its last user, even after a
//! crash. Memory is that of one buffer, however long the recording is.

use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Seek as _, Write as _};
use std::path::Path;

use portolan_atomic_file::{Disk, nameless_file};
use portolan_geometry::{Point3f, Rigid3, Time};
use portolan_lidar_odometry::SweepPoint;
use portolan_motion::MotionFilter;
use portolan_sensor::{TimedPoint, TimedPointCloudData};

use super::{MapPoint, RangeLimits, Reprojected, Reprojector, SmoothMotion};

/// Size of the buffer for writing and for reading, bytes.
const BUFFER: usize = 1 << 17;
/// Size of the header of a scan, bytes: time in ticks, resolution in metres, resolution in seconds, number of points.
const HEAD: usize = 20;
/// Size of a point, bytes: x, y and z in steps of the resolution, and the time back from that of the scan in steps.
const POINT: usize = 8;
/// Largest coordinate in steps, of either sign: steps of 3 mm in a scan that reaches 100 m.
const STEPS: f32 = 32_767.0;
const STEPS_OF_TIME: f32 = 65_535.0;
/// Maximum number of points stored of a scan, evenly spread over all of its points: some 300 kB a second.
const MOST_POINTS: usize = 4096;
/// Early scans are stored with more points, so that short recordings have full pictures: of the n-th scan up to this
/// number of points divided by n.
const FIRST_POINTS: usize = 2_000_000;
const FIRST_SCANS: u64 = (FIRST_POINTS / MOST_POINTS) as u64;
/// After `FIRST_SCANS` scans only those are stored that differ by more than this from the last stored one:
/// seconds, metres, radians.
const FAR: (f64, f64, f64) = (0.5, 0.02, 0.005);
/// No range limits: local SLAM has already dropped points out of range.
const ALL: RangeLimits = RangeLimits { min_range: 0.0, max_range: f32::INFINITY };

/// Points that local SLAM used of the scans of a recording, on disk.
#[derive(Debug, Default)]
pub struct KeptScans {
    file: Option<BufWriter<Disk<File>>>,
    failure: Option<io::Error>,
    last: Option<MotionFilter>,
    scans: u64,
    bytes: Vec<u8>,
}

impl KeptScans {
    /// Stores scans in a nameless file in this folder, which disappears with its last user.
    pub fn in_folder(folder: &Path) -> Self {
        let file = nameless_file(folder);
        let last = Some(MotionFilter::new(FAR.0, FAR.1, FAR.2));
        match file.map(|file| BufWriter::with_capacity(BUFFER, file)) {
            Ok(file) => Self { file: Some(file), last, ..Self::default() },
            Err(error) => Self { failure: Some(error), ..Self::default() },
        }
    }

    /// Stores a scan that shows a new part of the map: its points in the tracking frame, and the pose of that
    /// frame. When the disk is full all scans are dropped, and [`KeptScans::failure`] returns the error.
    pub fn keep(&mut self, time: Time, local_from_tracking: &Rigid3, points: &[SweepPoint]) {
        let is_similar = |last: &mut MotionFilter| last.is_similar(time, local_from_tracking);
        if !self.last.as_mut().is_none_or(is_similar) || self.scans < FIRST_SCANS {
            self.keep_points(time, points);
        }
    }

    fn keep_points(&mut self, time: Time, points: &[SweepPoint]) {
        let Some(file) = &mut self.file else { return };
        // Position and time of a point, if finite.
        let values = |p: &SweepPoint| {
            let values = [p.position.x, p.position.y, p.position.z, p.time];
            values.iter().all(|v| v.is_finite()).then_some(values)
        };
        // At least a micrometre and a microsecond, so that the steps are never zero.
        let (mut farthest, mut earliest) = (1e-6_f32, -1e-6_f32);
        for [x, y, z, offset] in points.iter().filter_map(values) {
            farthest = farthest.max(x.abs()).max(y.abs()).max(z.abs());
            earliest = earliest.min(offset);
        }
        let (step, step_of_time) = (farthest / STEPS, -earliest / STEPS_OF_TIME);
        self.bytes.clear();
        self.bytes.resize(HEAD, 0);
        let most = (FIRST_POINTS / (self.scans as usize + 1)).max(MOST_POINTS);
        let wanted = points.len().min(most);
        let spread = (0..wanted).map(|i| &points[i * points.len() / wanted]);
        let (per_step, per_step_of_time) = (1.0 / step, 1.0 / step_of_time);
        for [x, y, z, offset] in spread.filter_map(values) {
            // Rounds by truncation: `round` is a function call on generic CPU targets.
            let [x, y, z] = [x, y, z].map(|v| ((v * per_step + 0.5_f32.copysign(v)) as i16).to_le_bytes());
            let [g, h] = ((0.5 - offset * per_step_of_time) as u16).to_le_bytes();
            self.bytes.extend_from_slice(&[x[0], x[1], y[0], y[1], z[0], z[1], g, h]);
        }
        let count = ((self.bytes.len() - HEAD) / POINT) as u32;
        self.bytes[..8].copy_from_slice(&time.ticks().to_le_bytes());
        self.bytes[8..12].copy_from_slice(&step.to_le_bytes());
        self.bytes[12..16].copy_from_slice(&step_of_time.to_le_bytes());
        self.bytes[16..HEAD].copy_from_slice(&count.to_le_bytes());
        match file.write_all(&self.bytes) {
            Ok(()) => self.scans += 1,
            Err(error) => self.fail(error),
        }
    }

    fn fail(&mut self, error: io::Error) {
        // Dropping a `BufWriter` would write its buffer: take it apart instead.
        drop(self.file.take().map(BufWriter::into_parts));
        self.failure = Some(error);
    }

    /// Ends recording: flushes the buffer to the file and frees memory.
    pub fn finish(&mut self) {
        if let Some(Err(error)) = self.file.as_mut().map(BufWriter::flush) {
            self.fail(error);
        }
        self.bytes = Vec::new();
    }

    /// Error that ended the storing of scans, if any.
    pub fn failure(&self) -> Option<&io::Error> {
        self.failure.as_ref()
    }

    /// Whether scans are stored and no error has occurred.
    pub fn is_complete(&self) -> bool {
        self.file.is_some()
    }

    /// Re-projects the stored points by the motion of a finished trajectory: every n-th point of each scan (n
    /// = `every`), all for `every` = 1. Points outside of the trajectory are left out and counted. `visit`
    /// gets the points of each scan, with their times and without intensity. It ends the re-projection by
    /// returning false. To be called after [`KeptScans::finish`], as often as needed.
    ///
    /// # Errors
    /// The file cannot be read, or nothing was stored.
    pub fn reproject(
        &self,
        motion: &SmoothMotion,
        every: usize,
        visit: &mut dyn FnMut(&[MapPoint]) -> bool,
    ) -> io::Result<Reprojected> {
        let missing = || io::Error::new(io::ErrorKind::NotFound, "no scans were kept");
        let file = self.file.as_ref().ok_or_else(missing)?.get_ref().shared();
        let mut reader = BufReader::with_capacity(BUFFER, file);
        reader.rewind()?;
        let mut reprojector = Reprojector::new(motion, ALL);
        let mut bytes = Vec::new();
        let mut scan = TimedPointCloudData {
            time: Time::MIN,
            origin_in_tracking: Point3f::origin(),
            points_in_tracking: Vec::new(),
            intensities: Vec::new(),
        };
        for _ in 0..self.scans {
            read_scan(&mut reader, every, &mut bytes, &mut scan)?;
            if !visit(reprojector.place(&scan)) {
                return Ok(Reprojected { interrupted: true, ..reprojector.reprojected() });
            }
        }
        Ok(reprojector.reprojected())
    }
}

/// Reads every n-th point of the next scan.
fn read_scan(
    reader: &mut impl Read,
    every: usize,
    bytes: &mut Vec<u8>,
    scan: &mut TimedPointCloudData,
) -> io::Result<()> {
    let mut head = [0; HEAD];
    reader.read_exact(&mut head)?;
    let (ticks, rest) = head.split_first_chunk().unwrap_or((&[0; 8], &[]));
    let &[[a, b, c, d], of_time, count] = rest.as_chunks::<4>().0 else { return Ok(()) };
    let (step, step_of_time) = (f32::from_le_bytes([a, b, c, d]), f32::from_le_bytes(of_time));
    bytes.resize(u32::from_le_bytes(count) as usize * POINT, 0);
    reader.read_exact(bytes)?;
    scan.time = Time::from_ticks(i64::from_le_bytes(*ticks));
    scan.points_in_tracking.clear();
    let points = bytes.as_chunks::<POINT>().0.iter().step_by(every.max(1));
    scan.points_in_tracking.extend(points.map(|&[a, b, c, d, e, f, g, h]| {
        let metres = [[a, b], [c, d], [e, f]].map(|v| f32::from(i16::from_le_bytes(v)) * step);
        let time = -f32::from(u16::from_le_bytes([g, h])) * step_of_time;
        TimedPoint { position: Point3f::from(metres), time }
    }));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::{Duration, Vector3, nalgebra::Point3};

    fn at(scan: i64) -> Time {
        Time::from_ros(1_700_000_000, 0) + Duration::from_seconds(0.1 * scan as f64)
    }

    fn points(scan: i64) -> Vec<SweepPoint> {
        let point = |i: usize| {
            let position = Point3f::new(i as f32 * 0.3, scan as f32 - 7.0, -60.0 / (i + 1) as f32);
            SweepPoint { time: -0.0995 + 0.0005 * i as f32, position, intensity: 0.0 }
        };
        (0..200).map(point).collect()
    }

    fn kept(folder: &Path) -> KeptScans {
        let mut kept = KeptScans::in_folder(folder);
        for scan in 0..40 {
            let mut points = points(scan);
            points.push(SweepPoint { position: Point3f::new(1.0, f32::NAN, 0.0), ..points[0] });
            kept.keep_points(at(scan), &points);
        }
        kept.keep_points(at(40), &[]);
        kept.finish();
        kept
    }

    /// Straight motion at 20 m/s with a constant, rotated orientation.
    fn pose(scan: f64) -> Rigid3 {
        Rigid3::new(Vector3::new(2.0 * scan, 2.0, 3.0), Vector3::new(0.1, 0.2, 0.3))
    }

    #[test]
    fn scans_come_back_where_the_trajectory_puts_them() {
        let folder = tempfile::tempdir().unwrap();
        let kept = kept(folder.path());
        assert!(std::fs::read_dir(folder.path()).unwrap().next().is_none(), "the file has a name");
        let motion = SmoothMotion::new((1..40).map(|scan| (at(scan), pose(scan as f64))).collect());
        for _ in 0..2 {
            let mut scans = 0..;
            let reprojected = kept.reproject(&motion, 1, &mut |placed| {
                let scan: i64 = scans.next().unwrap();
                let expected = points(scan);
                for (placed, point) in placed.iter().zip(expected).filter(|_| scan > 1) {
                    let place = pose(scan as f64 + 10.0 * f64::from(point.time));
                    let error = (Point3::from(placed.position) - place * point.position.cast::<f64>()).norm();
                    // Half a step along each axis, and the distance travelled in half a step of time.
                    assert!(error < 0.002, "{scan}: {error}");
                }
                scan < 2 || placed.len() == 200 || scan == 40
            });
            // Before the end of the second scan the motion is unknown.
            let expected =
                Reprojected { points: 38 * 200 + 1, outside_trajectory: 399, ..Reprojected::default() };
            assert_eq!(reprojected.unwrap(), expected);
        }
        let stopped = kept.reproject(&motion, 1, &mut |_| false).unwrap();
        assert!(stopped.interrupted && stopped.points == 0);
    }

    #[test]
    fn of_large_scans_points_all_over_are_kept() {
        let folder = tempfile::tempdir().unwrap();
        let mut kept = KeptScans::in_folder(folder.path());
        let point = |i: usize| SweepPoint {
            time: 0.0,
            position: Point3f::new(i as f32 * 0.001, 0.0, 0.0),
            intensity: 0.0,
        };
        let points: Vec<SweepPoint> = (0..100_000).map(point).collect();
        (0..FIRST_SCANS).for_each(|_| kept.keep_points(at(0), &[]));
        kept.keep_points(at(0), &points);
        kept.finish();
        let motion = SmoothMotion::new(vec![(at(0), Rigid3::identity())]);
        let mut widest = 0.0_f64;
        let reprojected = kept.reproject(&motion, 1, &mut |placed| {
            widest = placed.windows(2).map(|w| w[1].position[0] - w[0].position[0]).fold(0.0, f64::max);
            true
        });
        assert_eq!(reprojected.unwrap().points, MOST_POINTS as u64);
        assert!(widest < 0.03, "{widest}");
    }

    #[test]
    fn what_cannot_be_written_is_no_scan_kept() {
        let motion = SmoothMotion::new(Vec::new());
        let mut kept = KeptScans::in_folder(Path::new("/no such folder"));
        kept.keep_points(at(0), &points(0));
        kept.finish();
        assert!(kept.failure().is_some() && !kept.is_complete());
        assert!(kept.reproject(&motion, 1, &mut |_| true).is_err());
        assert!(KeptScans::default().failure().is_none() && !KeptScans::default().is_complete());
        let Ok(full) = File::options().write(true).open("/dev/full") else { return };
        let mut kept = KeptScans { file: Some(BufWriter::new(Disk(full))), ..KeptScans::default() };
        (0..100).for_each(|scan| kept.keep_points(at(scan), &points(scan)));
        kept.finish();
        assert!(kept.failure().is_some() && !kept.is_complete());
    }
}
