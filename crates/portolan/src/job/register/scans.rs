//! Loads the scans that are registered.

use std::path::{Path, PathBuf};

use portolan_geometry::{Quaternion, Rigid3, Vector3};
use portolan_pointcloud::{CloudError, CloudReader, UosFolder, UosScan};
use portolan_registration::ScanCloud;

/// Width of a scan above which its unit is probably not metres, metres.
const WIDEST: f64 = 5000.0;
/// Width below which its unit is probably not metres, metres.
const NARROWEST: f64 = 0.02;
/// Ratio of the widths of two scans above which their units probably differ.
const UNLIKE: f64 = 50.0;

/// Which points of a scan are used, and in which unit they are.
#[derive(Clone, Copy, Debug)]
pub struct PointLimits {
    /// Factor of all coordinates, for files that are not in metres.
    pub scale: f64,
    /// Least distance from the origin of the scan, metres.
    pub min_range: f64,
    /// Greatest distance, metres; may be infinite.
    pub max_range: f64,
}

impl PointLimits {
    /// A point as it is used; none if it is too near or too far.
    pub fn point(&self, position: [f64; 3]) -> Option<[f64; 3]> {
        let scaled = position.map(|v| v * self.scale);
        let range = Vector3::from(scaled).norm();
        (range >= self.min_range && range <= self.max_range).then_some(scaled)
    }
}

/// Source of a scan.
#[derive(Clone, Debug)]
pub enum ScanSource {
    /// A cloud of any format.
    File(PathBuf),
    /// A uos scan.
    Uos(UosScan),
}

impl ScanSource {
    /// The scans in files and folders; folders of uos scans become their scans.
    ///
    /// # Errors
    /// A folder without uos scans, or one that cannot be read.
    pub fn all_of(paths: &[PathBuf]) -> Result<Vec<Self>, CloudError> {
        let mut sources = Vec::new();
        for path in paths {
            if path.is_dir() {
                sources.extend(UosFolder::open(path)?.scans.into_iter().map(Self::Uos));
            } else if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("3d")) {
                sources.push(Self::Uos(UosScan::open(path)?));
            } else {
                sources.push(Self::File(path.clone()));
            }
        }
        Ok(sources)
    }

    /// The file with its points.
    pub fn path(&self) -> &Path {
        match self {
            Self::File(path) => path,
            Self::Uos(scan) => &scan.points,
        }
    }

    /// Its points in its own frame.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn open(&self) -> Result<Box<dyn CloudReader>, CloudError> {
        match self {
            Self::File(path) => portolan_pointcloud::open(path),
            Self::Uos(scan) => Ok(scan.reader()),
        }
    }
}

/// All scans in memory.
pub struct Scans {
    /// Their names for users.
    pub names: Vec<String>,
    /// Their files.
    pub sources: Vec<ScanSource>,
    /// Which of their points are used.
    pub limits: PointLimits,
    /// The points that are matched.
    pub clouds: Vec<ScanCloud>,
    /// Initial poses from files beside the scans, otherwise the origin.
    pub guesses: Vec<Rigid3>,
    /// Whether some of the files are damaged.
    pub lost_data: bool,
    /// Origin of the points in memory, metres.
    pub from_origin: Rigid3,
    /// Position of the first scan, which is the origin of poses in memory, metres: poses may be in a national
    /// grid.
    pub from_first: Rigid3,
}

impl Scans {
    /// Suspected errors of units, in words.
    pub fn suspect_units(&self) -> Vec<String> {
        let width = |cloud: &ScanCloud| {
            let [low, high] = cloud.bounds();
            (0..3).map(|k| f64::from(high[k] - low[k])).fold(0.0, f64::max)
        };
        let widths: Vec<f64> = self.clouds.iter().map(width).collect();
        let mut lines = Vec::new();
        for (name, width) in self.names.iter().zip(&widths) {
            if *width > WIDEST {
                lines.push(format!(
                    "{name}: the scan is {width:.0} m wide; if its coordinates are millimetres, give --scale 0.001"
                ));
            } else if *width < NARROWEST {
                lines.push(format!(
                    "{name}: the scan is {width:.4} m wide; are its coordinates metres? (--scale multiplies them)"
                ));
            }
        }
        let by_width = |i: &usize, k: &usize| widths[*i].total_cmp(&widths[*k]);
        let ends = [(0..widths.len()).min_by(by_width), (0..widths.len()).max_by(by_width)];
        if let [Some(least), Some(most)] = ends
            && widths[most] > UNLIKE * widths[least]
        {
            lines.push(format!(
                "{} is {:.2} m wide and {} {:.2} m: are both of one unit?",
                self.names[least], widths[least], self.names[most], widths[most]
            ));
        }
        lines
    }

    /// Makes the position of this first pose the origin of poses in memory.
    pub fn count_from(&mut self, first: &Rigid3) {
        self.from_first = Rigid3::from_parts(first.translation, Quaternion::identity());
    }

    /// Converts the pose of a scan to that of its points in memory.
    pub fn about_origin(&self, pose: &Rigid3) -> Rigid3 {
        self.from_origin.inverse() * (self.from_first.inverse() * *pose) * self.from_origin
    }

    /// The pose of a scan from that of its points in memory.
    pub fn of_file(&self, pose: &Rigid3) -> Rigid3 {
        self.from_first * (self.from_origin * *pose * self.from_origin.inverse())
    }
}
