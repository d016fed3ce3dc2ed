//! Reads point clouds of any layout as timed points.

use portolan_geometry::{Duration, Point3f, Time};
use portolan_issue::IssueKind;
use portolan_recording::{FieldType, PointCloud2, PointField};
use portolan_sensor::TimedPoint;

use crate::point_time::{PointTime, PointTimeOrigin, TIME_FIELDS, TimeSpan};
use crate::timed_points::TimedPoints;

/// Coordinate above which a point is not a measurement, metres.
const HUGE: f32 = 1e6;

/// Approximate number of points of a cloud whose times are evaluated.
const SAMPLED_TIMES: usize = 256;

/// 2³² divided by the golden ratio.
const GOLDEN_STEP: u32 = 2_654_435_769;

/// Reasons why a cloud cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CloudError {
    /// There is no x, y or z of a number type.
    #[error("{}", self.kind().text())]
    NoCoordinates,
    /// A field extends beyond its point.
    #[error("{}", self.kind().text())]
    FieldOutside,
}

impl CloudError {
    /// As an issue.
    pub fn kind(&self) -> IssueKind {
        match self {
            Self::NoCoordinates => IssueKind::CloudWithoutCoordinates,
            Self::FieldOutside => IssueKind::CloudFieldOutside,
        }
    }
}

/// Counts of what was dropped or missing in a cloud.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CloudFaults {
    /// Points with a coordinate or time that is not finite, or farther than 1,000 km.
    pub not_finite: u64,
    /// Points whose time is far from those of the others.
    pub far_time: u64,
    /// Points at exactly (0, 0, 0): no return.
    pub zero: u64,
    /// Points that the header announces and the data do not have.
    pub missing: u64,
}

/// Names under which drivers give the intensity; the first one that exists counts.
const INTENSITY_FIELDS: [&str; 5] = ["intensity", "i", "reflectivity", "reflectance", "remission"];

#[derive(Clone, Copy, Debug, PartialEq)]
struct Field {
    offset: usize,
    field_type: FieldType,
}

impl Field {
    fn find(fields: &[PointField], name: &str, step: usize) -> Result<Option<Self>, CloudError> {
        let Some(field) = fields.iter().find(|f| f.name == name && f.count > 0) else { return Ok(None) };
        let Some(field_type) = field.field_type else { return Ok(None) };
        let offset = field.offset as usize;
        if offset.checked_add(field_type.size_bytes()).is_none_or(|end| end > step) {
            return Err(CloudError::FieldOutside);
        }
        Ok(Some(Self { offset, field_type }))
    }

    #[inline]
    fn bytes<const N: usize>(&self, point: &[u8], is_bigendian: bool) -> [u8; N] {
        let mut bytes = [0; N];
        if let Some(source) = point.get(self.offset..self.offset + N) {
            bytes.copy_from_slice(source);
        }
        if is_bigendian {
            bytes.reverse();
        }
        bytes
    }

    /// The value as a double; integers of 32 bits fit without loss.
    #[inline]
    fn value(&self, point: &[u8], big: bool) -> f64 {
        match self.field_type {
            FieldType::Int8 => f64::from(i8::from_le_bytes(self.bytes(point, big))),
            FieldType::Uint8 => f64::from(u8::from_le_bytes(self.bytes(point, big))),
            FieldType::Int16 => f64::from(i16::from_le_bytes(self.bytes(point, big))),
            FieldType::Uint16 => f64::from(u16::from_le_bytes(self.bytes(point, big))),
            FieldType::Int32 => f64::from(i32::from_le_bytes(self.bytes(point, big))),
            FieldType::Uint32 => f64::from(u32::from_le_bytes(self.bytes(point, big))),
            FieldType::Float32 => f64::from(f32::from_le_bytes(self.bytes(point, big))),
            FieldType::Float64 => f64::from_le_bytes(self.bytes(point, big)),
        }
    }

    /// The value as a single.
    #[inline]
    fn single(&self, point: &[u8], big: bool) -> f32 {
        match self.field_type {
            FieldType::Float32 => f32::from_le_bytes(self.bytes(point, big)),
            _ => self.value(point, big) as f32,
        }
    }
}

/// Offset of consecutive single-precision fields, if these are such.
fn offset_of_singles(fields: &[Field; 3]) -> Option<usize> {
    let [x, y, z] = fields.map(|field| field.offset);
    let are_singles = fields.iter().all(|field| field.field_type == FieldType::Float32);
    (are_singles && y == x.checked_add(4)? && z == y.checked_add(4)?).then_some(x)
}

/// Positions of the values within a point.
#[derive(Clone, Debug)]
pub struct CloudLayout {
    xyz: [Field; 3],
    time: Option<Field>,
    intensity: Option<Field>,
    step: usize,
    is_bigendian: bool,
    /// Offset of the coordinates if they are consecutive little-endian singles, as in nearly all clouds.
    offset_of_singles: Option<usize>,
    /// Metres in one unit of the coordinates.
    length_unit: f32,
}

impl CloudLayout {
    /// Finds the fields of a cloud by their names; order and types may be any.
    ///
    /// # Errors
    /// If the cloud has no coordinates, or a field does not fit into a point.
    pub fn of(cloud: &PointCloud2) -> Result<Self, CloudError> {
        let step = cloud.point_step as usize;
        let find = |name: &str| Field::find(&cloud.fields, name, step);
        let coordinate = |name: &str| find(name)?.ok_or(CloudError::NoCoordinates);
        let mut time = None;
        for name in TIME_FIELDS {
            if time.is_none() {
                time = find(name)?;
            }
        }
        let mut intensity = None;
        for name in INTENSITY_FIELDS {
            if intensity.is_none() {
                intensity = find(name)?;
            }
        }
        let xyz = [coordinate("x")?, coordinate("y")?, coordinate("z")?];
        Ok(Self {
            xyz,
            time,
            intensity,
            step,
            is_bigendian: cloud.is_bigendian,
            offset_of_singles: offset_of_singles(&xyz).filter(|_| !cloud.is_bigendian),
            length_unit: 1.0,
        })
    }

    /// Sets the unit of the coordinates, metres.
    pub fn with_length_unit(mut self, metres: f32) -> Self {
        self.length_unit = metres;
        self
    }

    /// Metres in one unit of the coordinates.
    pub fn length_unit(&self) -> f32 {
        self.length_unit
    }

    #[inline]
    fn position(&self, point: &[u8]) -> Point3f {
        if let Some(begin) = self.offset_of_singles
            && let Some(bytes) = point.get(begin..begin + 12)
            && let (&[x, y, z], []) = bytes.as_chunks::<4>()
        {
            let scaled = |bytes| self.length_unit * f32::from_le_bytes(bytes);
            return Point3f::new(scaled(x), scaled(y), scaled(z));
        }
        let [x, y, z] = self.xyz.map(|field| self.length_unit * field.single(point, self.is_bigendian));
        Point3f::new(x, y, z)
    }

    /// Whether there is a time field.
    pub fn has_time(&self) -> bool {
        self.time.is_some()
    }

    /// Calls `visit` with every point in the data; returns how many are missing.
    fn for_each<'a>(&self, cloud: &'a PointCloud2, mut visit: impl FnMut(&'a [u8])) -> u64 {
        let (width, height) = (u64::from(cloud.width), u64::from(cloud.height));
        let promised = width.saturating_mul(height);
        let packed_row = width.saturating_mul(self.step as u64);
        let row_step = u64::from(cloud.row_step);
        let mut seen = 0;
        if height <= 1 || row_step <= packed_row {
            for point in cloud.data.chunks_exact(self.step).take(promised.try_into().unwrap_or(usize::MAX)) {
                visit(point);
                seen += 1;
            }
        } else {
            // Rows with padding. A row step larger than the data ends the loop by itself.
            for row in cloud.data.chunks(row_step as usize).take(height as usize) {
                for point in row.chunks_exact(self.step).take(width as usize) {
                    visit(point);
                    seen += 1;
                }
            }
        }
        promised - seen
    }

    /// Calls `visit` with every `stride`-th point, unchanged.
    pub(crate) fn sample(&self, cloud: &PointCloud2, stride: usize, mut visit: impl FnMut(Point3f)) {
        let mut index = 0;
        self.for_each(cloud, |point| {
            if index % stride.max(1) == 0 {
                visit(self.position(point));
            }
            index += 1;
        });
    }

    /// Calls `visit` with every point, unchanged, and the value of its time if there is such a field.
    pub(crate) fn sample_timed(&self, cloud: &PointCloud2, mut visit: impl FnMut(Point3f, Option<f64>)) {
        self.for_each(cloud, |point| {
            visit(self.position(point), self.time.map(|field| field.value(point, cloud.is_bigendian)));
        });
    }

    /// The time values of a cloud, to determine their meaning. Points without a return are left out: some
    /// drivers leave their times unset.
    pub(crate) fn time_span(&self, cloud: &PointCloud2) -> Option<TimeSpan> {
        let field = self.time?;
        let (mut least, mut largest) = self.span_of_times(cloud, field, |_| true);
        let some = self.some_times(cloud, field);
        // A fiftieth at either end may be wrong.
        let cut = some.len() / 50;
        if let (Some(low), Some(high)) = (some.get(cut), some.get(some.len().wrapping_sub(1 + cut)))
            && largest - least > 1.5 * (high - low)
        {
            (least, largest) = (*low, *high);
        }
        let (stamp, span) = (cloud.header.stamp, largest - least);
        (least <= largest).then_some(TimeSpan { field_type: field.field_type, stamp, least, largest, span })
    }

    /// Time of the last point after the stamp, seconds, without points that have a wrong time.
    pub fn last_after_stamp(&self, cloud: &PointCloud2, time: PointTime) -> Option<f64> {
        let field = self.time?;
        let middle = self.middle_time(cloud, field);
        let (least, largest) = self.span_of_times(cloud, field, |value| is_near(value, middle, time));
        largest.is_finite().then(|| (least * time.unit).max(largest * time.unit))
    }

    /// Smallest and largest value of points with a return that meet a condition.
    fn span_of_times(&self, cloud: &PointCloud2, field: Field, counts: impl Fn(f64) -> bool) -> (f64, f64) {
        let (mut least, mut largest) = (f64::INFINITY, f64::NEG_INFINITY);
        self.for_each(cloud, |point| {
            if let Some(value) = self.time_value(point, field, cloud.is_bigendian).filter(|v| counts(*v)) {
                (least, largest) = (least.min(value), largest.max(value));
            }
        });
        (least, largest)
    }

    /// The time value of a point with a return.
    fn time_value(&self, point: &[u8], field: Field, big: bool) -> Option<f64> {
        let value = field.value(point, big);
        let [x, y, z] = &self.xyz;
        let (x, y, z) = (x.single(point, big), y.single(point, big), z.single(point, big));
        let is_point = (x + y + z).is_finite() && (x != 0.0 || y != 0.0 || z != 0.0);
        (is_point && value.is_finite()).then_some(value)
    }

    /// Time values of some points, spread over the cloud, ascending.
    fn some_times(&self, cloud: &PointCloud2, field: Field) -> Vec<f64> {
        // Samples by steps of the golden ratio: equal steps may hit only two columns of an organised cloud.
        let one_in = |share: u32| {
            let (mut index, mut times) = (0u32, Vec::new());
            self.for_each(cloud, |point| {
                if index.wrapping_mul(GOLDEN_STEP) <= u32::MAX / share {
                    times.extend(self.time_value(point, field, cloud.is_bigendian));
                }
                index = index.wrapping_add(1);
            });
            times
        };
        let share = cloud.data.len() / self.step.max(1) / SAMPLED_TIMES;
        let mut times = one_in(u32::try_from(share).unwrap_or(u32::MAX).max(1));
        if times.len() < SAMPLED_TIMES / 8 {
            times = one_in(1);
        }
        times.sort_by(f64::total_cmp);
        times
    }

    fn middle_time(&self, cloud: &PointCloud2, field: Field) -> f64 {
        let times = self.some_times(cloud, field);
        times.get(times.len() / 2).copied().unwrap_or(0.0)
    }

    /// The points, with times according to `point_time` (none: all at the stamp).
    pub fn points(
        &self,
        stamp: Time,
        cloud: &PointCloud2,
        point_time: Option<PointTime>,
        with_intensities: bool,
    ) -> (TimedPoints, CloudFaults) {
        let with_intensities = with_intensities && self.intensity.is_some();
        let available = cloud.data.len() / self.step.max(1);
        let mut result = TimedPoints::with_capacity(available, with_intensities);
        let mut faults = CloudFaults::default();
        let times = self.time.zip(point_time).map(|(field, time)| {
            let middle = self.middle_time(cloud, field);
            (field, time, middle, self.time_reference(cloud, field, time, middle))
        });
        let big = self.is_bigendian;
        faults.missing = self.for_each(cloud, |point| {
            let position = self.position(point);
            let (x, y, z) = (position.x, position.y, position.z);
            let (time, is_near) = times.map_or((0.0, true), |(field, time, middle, reference)| {
                let value = field.value(point, big);
                // A value that is not finite is counted as such.
                (((value - reference) * time.unit) as f32, !value.is_finite() || is_near(value, middle, time))
            });
            if x == 0.0 && y == 0.0 && z == 0.0 {
                faults.zero += 1;
            } else if !is_near {
                faults.far_time += 1;
            } else if x.abs() < HUGE && y.abs() < HUGE && z.abs() < HUGE && time.is_finite() {
                result.points.push(TimedPoint { position, time });
                if with_intensities {
                    result.intensities.push(self.intensity.map_or(0.0, |f| f.single(point, big)));
                }
            } else {
                faults.not_finite += 1;
            }
        });
        let base = self.base_time(stamp, point_time, times.map(|(_, _, _, reference)| reference));
        // Times of a clock are shifted with the stamps, which may have been corrected.
        let is_of_clock = point_time.is_some_and(|time| time.origin == PointTimeOrigin::Epoch);
        let was_set = cloud.header.stamp != Time::UNIX_EPOCH;
        let moved = if is_of_clock && was_set { stamp - cloud.header.stamp } else { Duration::ZERO };
        result.rebase(base + moved);
        (result, faults)
    }

    /// The value that counts as zero: that of the first point for clocks, so that no digits are lost.
    fn time_reference(&self, cloud: &PointCloud2, field: Field, time: PointTime, middle: f64) -> f64 {
        match time.origin {
            PointTimeOrigin::Stamp => 0.0,
            PointTimeOrigin::Epoch | PointTimeOrigin::OtherClock => {
                let (least, _) = self.span_of_times(cloud, field, |value| is_near(value, middle, time));
                if least.is_finite() { least } else { 0.0 }
            }
        }
    }

    fn base_time(&self, stamp: Time, time: Option<PointTime>, reference: Option<f64>) -> Time {
        match (time, reference) {
            (Some(PointTime { unit: 1.0, origin: PointTimeOrigin::Epoch, .. }), Some(reference)) => {
                Time::from_unix_seconds(reference)
            }
            (Some(PointTime { unit, origin: PointTimeOrigin::Epoch, .. }), Some(reference)) => {
                Time::from_unix_nanoseconds((reference * (unit * 1e9).round()) as i64)
            }
            _ => stamp,
        }
    }
}

/// Whether a time value can belong to the sweep whose median it is compared with.
fn is_near(value: f64, middle: f64, time: PointTime) -> bool {
    (value - middle).abs() * time.unit.abs() <= time.reach
}

#[cfg(test)]
#[path = "point_cloud2_tests.rs"]
mod tests;
