//! Scans that are registered.

use std::path::{Path, PathBuf};

use portolan_geometry::{Quaternion, Rigid3, Vector3};
use portolan_pointcloud::{CloudError, CloudReader, UosScan};
use portolan_registration::ScanCloud;

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

/// Where a scan comes from.
#[derive(Clone, Debug)]
pub enum ScanSource {
    /// A cloud of any format.
    File(PathBuf),
    /// A uos scan.
    Uos(UosScan),
}

impl ScanSource {
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
    /// For people.
    pub names: Vec<String>,
    /// Their files.
    pub sources: Vec<ScanSource>,
    /// Which of their points are used.
    pub limits: PointLimits,
    /// The points that are matched.
    pub clouds: Vec<ScanCloud>,
    /// First poses from files beside the scans, else the origin.
    pub guesses: Vec<Rigid3>,
    /// Whether some of the files are damaged.
    pub lost_data: bool,
    /// Place that the points in memory count from, metres.
    pub from_origin: Rigid3,
    /// Place of the first scan, which poses in memory count from, metres: poses may be those of a national grid.
    pub from_first: Rigid3,
}

impl Scans {
    /// Makes poses in memory count from the place of the first of these.
    pub fn count_from(&mut self, first: &Rigid3) {
        self.from_first = Rigid3::from_parts(first.translation, Quaternion::identity());
    }

    /// A pose of a scan as that of its points in memory.
    pub fn about_origin(&self, pose: &Rigid3) -> Rigid3 {
        self.from_origin.inverse() * (self.from_first.inverse() * *pose) * self.from_origin
    }

    /// The pose of a scan from that of its points in memory.
    pub fn of_file(&self, pose: &Rigid3) -> Rigid3 {
        self.from_first * (self.from_origin * *pose * self.from_origin.inverse())
    }
}
