//! Reads files of points.

use std::path::Path;

use portolan_issue::Issue;
use portolan_pointcloud::{CloudError, CloudReader, PointCloud};

/// Points of a cloud, every n-th if there are very many.
#[derive(Debug, Default)]
pub struct ReadCloud {
    /// Coordinates, metres.
    pub points: Vec<[f64; 3]>,
    /// Times, seconds; empty if the file has none.
    pub seconds: Vec<f64>,
    /// Points with finite coordinates in the file.
    pub total: u64,
    /// Points whose coordinates are not numbers.
    pub not_finite: u64,
    /// Repairs and losses.
    pub issues: Vec<Issue>,
}

impl ReadCloud {
    /// Whether data were lost while reading.
    pub fn lost_data(&self) -> bool {
        self.issues.iter().any(Issue::lost_data)
    }
}

/// Reads a cloud of any format, or a folder of uos scans. Whenever there are more than `limit` points every
/// second one is left out, evenly over the whole file.
///
/// # Errors
/// Fails if the file cannot be read. A file without points is read.
pub fn read_cloud(path: &Path, limit: usize) -> Result<ReadCloud, CloudError> {
    read_cloud_from(portolan_pointcloud::open(path)?, limit)
}

/// The same from a reader.
///
/// # Errors
/// As [`read_cloud`].
pub fn read_cloud_from(mut reader: Box<dyn CloudReader>, limit: usize) -> Result<ReadCloud, CloudError> {
    let has_times = reader.attributes().time;
    let (mut cloud, mut batch, mut stride) = (ReadCloud::default(), PointCloud::default(), 1_u64);
    while reader.next_batch(&mut batch)? {
        for i in 0..batch.len() {
            let position = batch.position(i);
            if !position.iter().all(|v| v.is_finite()) {
                cloud.not_finite += 1;
                continue;
            }
            cloud.total += 1;
            if cloud.total.is_multiple_of(stride) {
                cloud.points.push(position);
                if has_times {
                    cloud.seconds.push(batch.time(i).unwrap_or(f64::NAN));
                }
            }
            if cloud.points.len() > limit.max(2) {
                stride *= 2;
                every_second(&mut cloud.points);
                every_second(&mut cloud.seconds);
            }
        }
    }
    cloud.issues = reader.issues();
    Ok(cloud)
}

/// Keeps the second, fourth, … value.
fn every_second<T>(values: &mut Vec<T>) {
    let mut index = 0_u64;
    values.retain(|_| {
        index += 1;
        index.is_multiple_of(2)
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn large_clouds_are_thinned_evenly_and_bad_points_counted() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("line.xyz");
        let mut text = "x y z time\n".to_owned();
        (1..=1000).for_each(|i| text += &format!("{i} 0 0 {}\n", f64::from(i) * 0.5));
        text += "nan 0 0 1\n";
        std::fs::write(&path, text).unwrap();
        let cloud = read_cloud(&path, 100).unwrap();
        assert_eq!(cloud.total, 1000);
        assert!((50..=100).contains(&cloud.points.len()) && cloud.points.len() == cloud.seconds.len());
        let step = cloud.points[1][0] - cloud.points[0][0];
        assert!(cloud.points.windows(2).all(|w| w[1][0] - w[0][0] == step));
        assert_eq!(cloud.seconds[3], 0.5 * cloud.points[3][0]);
        std::fs::write(&path, "x y z\n").unwrap();
        assert_eq!(read_cloud(&path, 100).unwrap().total, 0);
    }
}
