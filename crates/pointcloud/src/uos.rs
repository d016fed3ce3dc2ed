//! Reads folders of uos scans: `scan000.3d` with points, `scan000.pose` with an initial guess of the pose,
//! and `scan000.frames` with its poses during registration.
//!
//! These files are left-handed: x to the right, y up, z ahead, in centimetres and degrees. They are converted
//! to x ahead, y to the left, z up, in metres.

use std::path::{Path, PathBuf};

use portolan_geometry::{Rigid3, Vector3, nalgebra as na};
use portolan_issue::{Issue, IssueKind, IssueLog};

use crate::BATCH_POINTS;
use crate::cloud::{Attributes, PointCloud};
use crate::error::CloudError;
use crate::format::CloudReader;
use crate::input::{Input, numbers};

/// Number of lines at the start of a scan that need not be points.
const HEAD_LINES: usize = 10;
const METRES: f64 = 0.01;

/// One state of a scan during registration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UosFrame {
    /// Pose of the scan.
    pub world_from_scan: Rigid3,
    /// 0 invalid, 1 moved by ICP, 2 waiting, 3 moved by LUM, 4 moved by ELCH.
    pub kind: u32,
}

/// One scan of a folder.
#[derive(Clone, Debug, PartialEq)]
pub struct UosScan {
    /// Its number.
    pub number: u64,
    /// File of its points.
    pub points: PathBuf,
    /// Initial guess of its pose, from `.pose`, if there is such a file.
    pub guess: Option<Rigid3>,
    /// Its states, from `.frames`; the last one is the result.
    pub frames: Vec<UosFrame>,
}

impl UosScan {
    /// Opens a scan by the file of its points (`scan000.3d`), with the files of its poses in the same folder.
    ///
    /// # Errors
    /// Fails if its pose or frames cannot be parsed.
    pub fn open(points: impl AsRef<Path>) -> Result<Self, CloudError> {
        let points = points.as_ref().to_owned();
        let stem = points.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let number = stem.trim_start_matches(|c: char| !c.is_ascii_digit()).parse().unwrap_or(0);
        let guess = read_pose(&points.with_extension("pose"))?;
        let frames = read_frames(&points.with_extension("frames"))?;
        Ok(Self { number, points, guess, frames })
    }

    /// Reads its points in its own frame.
    pub fn reader(&self) -> Box<dyn CloudReader> {
        let scan = Self { guess: None, frames: Vec::new(), ..self.clone() };
        let path = self.points.clone();
        Box::new(UosFolder { path, scans: vec![scan] }.into_reader())
    }

    /// The result of registration; without it the initial guess, or else the identity.
    pub fn world_from_scan(&self) -> Rigid3 {
        self.frames.last().map(|frame| frame.world_from_scan).or(self.guess).unwrap_or_default()
    }
}

/// A folder of scans, in order of their numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct UosFolder {
    path: PathBuf,
    /// The scans.
    pub scans: Vec<UosScan>,
}

/// Converts left-handed centimetres to our axes: (x right, y up, z ahead) becomes (z, −x, y).
fn point(x: f64, y: f64, z: f64) -> Vector3 {
    Vector3::new(z, -x, y) * METRES
}

/// Converts a left-handed rotation matrix to our axes: the same permutation on both sides.
fn rotation(matrix: &na::Matrix3<f64>) -> na::UnitQuaternion<f64> {
    let ours_from_uos = na::Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, 1.0, 0.0);
    na::UnitQuaternion::from_matrix(&(ours_from_uos * matrix * ours_from_uos.transpose()))
}

impl UosFolder {
    /// Finds the scans of a folder.
    ///
    /// # Errors
    /// Fails if the folder cannot be read, has no scans, or a pose cannot be parsed.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, CloudError> {
        let path = path.as_ref();
        let error = |e| CloudError::read(path, e);
        let mut scans = Vec::new();
        for entry in std::fs::read_dir(path).map_err(error)? {
            let points = entry.map_err(error)?.path();
            let stem = points.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            let number: Option<u64> = stem.strip_prefix("scan").and_then(|n| n.parse().ok());
            if number.is_some() && points.extension().is_some_and(|e| e == "3d") {
                scans.push(UosScan::open(points)?);
            }
        }
        if scans.is_empty() {
            let detail = "the folder has no scan000.3d, scan001.3d, … (uos)".to_owned();
            return Err(CloudError::UnknownFormat { path: path.to_owned(), detail });
        }
        scans.sort_by(|a, b| (a.number, &a.points).cmp(&(b.number, &b.points)));
        Ok(Self { path: path.to_owned(), scans })
    }

    /// Reads all points, transformed by the poses of their scans.
    pub(crate) fn into_reader(self) -> UosReader {
        UosReader { attributes: None, folder: self, next: 0, open: None, issues: IssueLog::default() }
    }
}

/// All numbers of a short file; none if it does not exist.
fn all_numbers(path: &Path) -> Result<Option<Vec<Vec<f64>>>, CloudError> {
    if !path.is_file() {
        return Ok(None);
    }
    let mut input = Input::open(path)?;
    let (mut lines, mut values) = (Vec::new(), Vec::new());
    while let Some(line) = input.line()? {
        if line.trim().is_empty() {
            continue;
        }
        if !numbers(line, &mut values) || values.iter().any(|v| !v.is_finite()) {
            return Err(CloudError::damaged(path, "it has a line that is not numbers"));
        }
        lines.push(values.clone());
    }
    Ok(Some(lines))
}

/// Reads position, and angles about x, y and z in degrees: R = Rx Ry Rz.
fn read_pose(path: &Path) -> Result<Option<Rigid3>, CloudError> {
    let Some(lines) = all_numbers(path)? else { return Ok(None) };
    let values: Vec<f64> = lines.into_iter().flatten().collect();
    let &[x, y, z, rx, ry, rz] = values.as_slice() else {
        return Err(CloudError::damaged(path, "it does not have six numbers: x y z and three angles"));
    };
    let turn =
        |axis: na::Unit<Vector3>, degrees: f64| na::Rotation3::from_axis_angle(&axis, degrees.to_radians());
    let matrix = turn(Vector3::x_axis(), rx) * turn(Vector3::y_axis(), ry) * turn(Vector3::z_axis(), rz);
    Ok(Some(Rigid3::from_parts(point(x, y, z).into(), rotation(matrix.matrix()))))
}

/// Reads lines of sixteen numbers in column-major order, and a kind.
fn read_frames(path: &Path) -> Result<Vec<UosFrame>, CloudError> {
    let lines = all_numbers(path)?.unwrap_or_default();
    let frame = |v: &Vec<f64>| {
        let matrix = v.first_chunk::<16>()?;
        let kind = v.get(16).copied().unwrap_or(0.0).clamp(0.0, 1e6) as u32;
        let turn = na::Matrix4::from_column_slice(matrix).fixed_view::<3, 3>(0, 0).into_owned();
        let is_rotation = (turn * turn.transpose() - na::Matrix3::identity()).norm() < 1e-2;
        let place = point(matrix[12], matrix[13], matrix[14]);
        is_rotation
            .then(|| UosFrame { world_from_scan: Rigid3::from_parts(place.into(), rotation(&turn)), kind })
    };
    let frames: Option<Vec<UosFrame>> = lines.iter().map(frame).collect();
    frames.ok_or_else(|| {
        CloudError::damaged(path, "it has a line that is no rigid transform (16 numbers and a kind)")
    })
}

/// The initial guess of a pose as text: content of `.pose` files.
pub fn uos_pose_text(world_from_scan: &Rigid3) -> String {
    let (matrix, place) = in_uos_axes(world_from_scan);
    // R = Rx Ry Rz; of the two solutions that with a non-negative cosine of the middle angle.
    let cosine = matrix.m11.hypot(matrix.m12);
    let angles = if cosine > 1e-9 {
        [(-matrix.m23).atan2(matrix.m33), matrix.m13.atan2(cosine), (-matrix.m12).atan2(matrix.m11)]
    } else {
        [0.0, matrix.m13.atan2(cosine), matrix.m21.atan2(matrix.m22)]
    };
    let [rx, ry, rz] = angles.map(f64::to_degrees);
    format!("{:.6} {:.6} {:.6}\n{rx:.9} {ry:.9} {rz:.9}\n", place.x, place.y, place.z)
}

/// The states of a scan as text: content of `.frames` files.
pub fn uos_frames_text(frames: &[UosFrame]) -> String {
    let line = |frame: &UosFrame| {
        let (m, t) = in_uos_axes(&frame.world_from_scan);
        // Column-major, each column followed by a zero.
        let column = |c: &[f64]| c.iter().map(|v| format!("{v:.12} ")).collect::<String>() + "0 ";
        let columns: String = m.as_slice().chunks_exact(3).map(column).collect();
        format!("{columns}{:.6} {:.6} {:.6} 1 {}\n", t.x, t.y, t.z, frame.kind)
    };
    frames.iter().map(line).collect()
}

/// Rotation matrix and position (centimetres) in left-handed axes.
fn in_uos_axes(pose: &Rigid3) -> (na::Matrix3<f64>, Vector3) {
    let ours_from_uos = na::Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, 1.0, 0.0);
    let ours = pose.rotation.to_rotation_matrix();
    let place = ours_from_uos.transpose() * pose.translation.vector / METRES;
    (ours_from_uos.transpose() * ours.matrix() * ours_from_uos, place)
}

/// Reads all scans one after the other.
pub(crate) struct UosReader {
    folder: UosFolder,
    /// Attributes of the first scan.
    attributes: Option<Attributes>,
    next: usize,
    open: Option<(Input, Rigid3, usize)>,
    issues: IssueLog,
}

impl UosReader {
    /// Adds the point of a line; false if the line is not a point.
    fn push(&mut self, values: &[f64], world_from_scan: &Rigid3, batch: &mut PointCloud) -> bool {
        let &[x, y, z, ref rest @ ..] = values else { return false };
        let position = world_from_scan * na::Point3::from(point(x, y, z));
        if !position.iter().all(|v| v.is_finite()) {
            self.issues.count(IssueKind::CloudPointNotFinite, 1);
            return true;
        }
        let (intensity, color) = match rest {
            [r, g, b, ..] => (0.0, [*r, *g, *b].map(|c| c.clamp(0.0, 255.0) as u8)),
            [reflectance, ..] => (*reflectance as f32, [0; 3]),
            [] => (0.0, [0; 3]),
        };
        batch.push([position.x, position.y, position.z], intensity, 0.0, color);
        true
    }

    /// Detects whether points of the first scan have reflectance or colours.
    fn look(&self) -> Attributes {
        let Some(scan) = self.folder.scans.first() else { return Attributes::default() };
        let Ok(mut input) = Input::open(&scan.points) else { return Attributes::default() };
        let mut values = Vec::new();
        for _ in 0..=HEAD_LINES {
            match input.line() {
                Ok(Some(line)) if numbers(line, &mut values) && values.len() >= 3 => {
                    let more = values.len() - 3;
                    return Attributes { intensity: more == 1 || more == 2, time: false, color: more >= 3 };
                }
                Ok(Some(_)) => {}
                _ => break,
            }
        }
        Attributes::default()
    }
}

impl CloudReader for UosReader {
    fn attributes(&self) -> Attributes {
        self.attributes.unwrap_or_else(|| self.look())
    }

    fn count(&self) -> Option<u64> {
        None
    }

    fn next_batch(&mut self, batch: &mut PointCloud) -> Result<bool, CloudError> {
        let attributes = self.attributes();
        self.attributes = Some(attributes);
        batch.reset(attributes);
        let mut values = Vec::new();
        while batch.len() < BATCH_POINTS {
            let Some((mut input, pose, mut line_number)) = self.open.take() else {
                let Some(scan) = self.folder.scans.get(self.next) else { break };
                self.open = Some((Input::open(&scan.points)?, scan.world_from_scan(), 0));
                self.next += 1;
                continue;
            };
            let Some(line) = input.line()? else { continue };
            line_number += 1;
            let is_blank = line.trim().is_empty();
            let is_point = numbers(line, &mut values) && self.push(&values, &pose, batch);
            if !is_point && !is_blank && line_number > HEAD_LINES {
                self.issues.count(IssueKind::CloudLineUnreadable, 1);
            }
            self.open = Some((input, pose, line_number));
        }
        Ok(!batch.is_empty())
    }

    fn issues(&self) -> Vec<Issue> {
        self.issues.list()
    }
}

impl UosFolder {
    /// Path of the folder.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)] // tests
mod tests {
    use super::*;

    #[test]
    fn poses_and_frames_are_read_as_they_were_written() {
        let folder = tempfile::tempdir().unwrap();
        let points = folder.path().join("scan007.3d");
        std::fs::write(&points, "100 200 300\n-10 5 0\n").unwrap();
        for angles in [[0.1, -0.4, 2.9], [3.0, 0.2, -1.0], [0.0, std::f64::consts::FRAC_PI_2, 0.3]] {
            let pose = Rigid3::new(Vector3::new(1.5, -2.0, 0.25), Vector3::from(angles));
            std::fs::write(points.with_extension("pose"), uos_pose_text(&pose)).unwrap();
            let frames =
                [UosFrame { world_from_scan: pose, kind: 1 }, UosFrame { world_from_scan: pose, kind: 3 }];
            std::fs::write(points.with_extension("frames"), uos_frames_text(&frames)).unwrap();
            let scan = UosScan::open(&points).unwrap();
            let near = |a: &Rigid3| (a.to_homogeneous() - pose.to_homogeneous()).norm() < 1e-6;
            assert!(near(&scan.guess.unwrap()) && scan.frames.len() == 2 && near(&scan.world_from_scan()));
            assert_eq!((scan.number, scan.frames[1].kind), (7, 3));
        }
        let mut batch = PointCloud::default();
        assert!(UosScan::open(&points).unwrap().reader().next_batch(&mut batch).unwrap());
        assert_eq!((batch.len(), batch.position(0)), (2, [3.0, -1.0, 2.0]));
    }
}
