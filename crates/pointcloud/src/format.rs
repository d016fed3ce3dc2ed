//! Opens and creates clouds. The format is detected by content when reading, by extension when writing.

use std::path::Path;

use portolan_issue::Issue;

use crate::cloud::{Attributes, PointCloud};
use crate::error::CloudError;
use crate::input::Input;
use crate::{e57, las, pcd, ply, uos, xyz};

/// A file format of clouds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CloudFormat {
    /// Polygon File Format.
    Ply,
    /// Point Cloud Data of PCL.
    Pcd,
    /// Text.
    Xyz,
    /// LAS.
    Las,
    /// Compressed LAS.
    Laz,
    /// ASTM E2807.
    E57,
}

impl CloudFormat {
    /// The format by the extension of a file.
    ///
    /// # Errors
    /// [`CloudError::UnknownFormat`] for an unknown extension, and for a name without one.
    pub fn from_path(path: &Path) -> Result<Self, CloudError> {
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
        match extension.as_str() {
            "ply" => Ok(Self::Ply),
            "pcd" => Ok(Self::Pcd),
            "xyz" | "txt" | "pts" | "asc" | "csv" => Ok(Self::Xyz),
            "las" => Ok(Self::Las),
            "laz" => Ok(Self::Laz),
            "e57" => Ok(Self::E57),
            _ => Err(CloudError::UnknownFormat {
                path: path.to_owned(),
                detail: "its name has to end in .ply, .pcd, .xyz, .las, .laz or .e57".to_owned(),
            }),
        }
    }
}

/// Encoding of values in formats with a choice (PLY and PCD).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Encoding {
    /// Binary, little-endian.
    #[default]
    Binary,
    /// Compressed binary in PCD; the same as binary in PLY.
    Compressed,
    /// Text.
    Ascii,
}

/// Precision of coordinates in PLY and PCD.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Precision {
    /// Double in PLY and single in PCD, as PCL expects. In PCD also double if the first point is so far from
    /// the origin that single precision would lose millimetres.
    #[default]
    Usual,
    /// Single.
    Single,
    /// Double.
    Double,
}

/// Options of writing.
#[derive(Clone, Debug, PartialEq)]
pub struct WriteOptions {
    /// None: by the extension.
    pub format: Option<CloudFormat>,
    /// Encoding of PLY and PCD.
    pub encoding: Encoding,
    /// Precision of PLY and PCD.
    pub precision: Precision,
    /// Resolution of coordinates in LAS and LAZ, metres. Default 0.0001.
    pub resolution: f64,
    /// Offset of coordinates in LAS and LAZ, metres; none: a point near the first point.
    pub origin: Option<[f64; 3]>,
}

impl Default for WriteOptions {
    fn default() -> Self {
        Self {
            format: None,
            encoding: Encoding::default(),
            precision: Precision::default(),
            resolution: 1e-4,
            origin: None,
        }
    }
}

/// Reads a cloud in batches.
pub trait CloudReader {
    /// Attributes of its points.
    fn attributes(&self) -> Attributes;

    /// Number of points, if the file states it.
    fn count(&self) -> Option<u64>;

    /// Replaces `batch` by the next points; false at the end, where it is empty.
    ///
    /// # Errors
    /// Reading fails, or the rest is too damaged to continue.
    fn next_batch(&mut self, batch: &mut PointCloud) -> Result<bool, CloudError>;

    /// Repairs and omissions so far.
    fn issues(&self) -> Vec<Issue>;
}

/// Counts of written and omitted points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Written {
    /// Points in the file.
    pub points: u64,
    /// Points left out because their coordinates are not finite.
    pub not_finite: u64,
}

/// Writes a cloud in batches. The file appears under its name when it is finished; if the writer is dropped
/// before, nothing remains. The same points give the same bytes.
pub trait CloudWriter: Send {
    /// Appends points; values that they lack become 0.
    ///
    /// # Errors
    /// Writing fails, or the format cannot store these points.
    fn write(&mut self, batch: &PointCloud) -> Result<(), CloudError>;

    /// Completes the file.
    ///
    /// # Errors
    /// Writing fails, or the file cannot be renamed.
    fn finish(self: Box<Self>) -> Result<Written, CloudError>;
}

/// Opens a cloud: a file of any format, detected by its content, or a folder of uos scans. PLY, PCD and text
/// may come through a pipe (`/dev/stdin`, `-`); LAS and E57 need random access.
///
/// # Errors
/// Fails if the file cannot be read, is of no known format, or if its header is damaged.
pub fn open(path: impl AsRef<Path>) -> Result<Box<dyn CloudReader>, CloudError> {
    let path = path.as_ref();
    if path.is_dir() {
        return Ok(Box::new(uos::UosFolder::open(path)?.into_reader()));
    }
    let mut input = Input::open(path)?;
    let start = input.peek(512)?.to_vec();
    if start.starts_with(b"ply") {
        Ok(Box::new(ply::PlyReader::open(input)?))
    } else if start.starts_with(b"LASF") {
        las::open(path)
    } else if start.starts_with(b"ASTM-E57") {
        e57::open(path)
    } else if pcd::sniff(&start) {
        Ok(Box::new(pcd::PcdReader::open(input)?))
    } else if xyz::sniff(&start) {
        Ok(Box::new(xyz::XyzReader::open(input)?))
    } else {
        Err(CloudError::UnknownFormat {
            path: path.to_owned(),
            detail: match portolan_input::unwanted_kind_of(&start) {
                Some(kind) => format!("it is {kind}"),
                None => "its content is not of PLY, PCD, LAS, LAZ, E57 or text with coordinates".to_owned(),
            },
        })
    }
}

/// Creates a cloud whose points have `attributes`.
///
/// # Errors
/// Fails if the format is not clear from the extension, or the file cannot be created.
pub fn create(
    path: impl AsRef<Path>,
    attributes: Attributes,
    options: &WriteOptions,
) -> Result<Box<dyn CloudWriter>, CloudError> {
    let path = path.as_ref();
    let format = match options.format {
        Some(format) => format,
        None => CloudFormat::from_path(path)?,
    };
    Ok(match format {
        CloudFormat::Ply => Box::new(ply::PlyWriter::create(path, attributes, options)?),
        CloudFormat::Pcd => Box::new(pcd::PcdWriter::create(path, attributes, options)?),
        CloudFormat::Xyz => Box::new(xyz::XyzWriter::create(path, attributes)?),
        CloudFormat::Las => Box::new(las::LasWriter::create(path, attributes, options, false)?),
        CloudFormat::Laz => Box::new(las::LasWriter::create(path, attributes, options, true)?),
        CloudFormat::E57 => Box::new(e57::E57Writer::create(path, attributes)?),
    })
}
