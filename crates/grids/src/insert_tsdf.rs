//! Inserts range data into a truncated signed distance field.

use portolan_geometry::{Point3f, Vector2f};
use portolan_sensor::RangeData;

use super::insert_probability::{
    Bounds, DEFAULT_MAX_CELLS, InsertReport, SUBPIXELS, SubpixelIndex, is_finite,
};
use super::normals::{NormalEstimationOptions, estimate_normals, sort_by_direction};
use super::{CellIndex, GridError, InserterOptionError, Tsdf2d, for_each_cell_on_ray};

/// Options of inserting scans into a distance field.
#[derive(Clone, Debug, PartialEq)]
pub struct TsdfInserterOptions {
    /// Distances are clamped to this, metres, default 0.3; that of the field.
    pub truncation_distance: f64,
    /// Weights are clamped to this, default 10; that of the field.
    pub maximum_weight: f64,
    /// Whether cells between sensor and surface are updated too, default false.
    pub update_free_space: bool,
    /// Options of the estimation of normals.
    pub normal_estimation: NormalEstimationOptions,
    /// Whether distances are measured along the surface normal rather than along the ray, default true.
    pub project_sdf_distance_to_scan_normal: bool,
    /// Weights fall with range to this power, default 0.
    pub update_weight_range_exponent: i32,
    /// Width (radians) of the kernel by which weights fall with the angle between normal and ray; 0 for
    /// none, default 0.5.
    pub update_weight_angle_scan_normal_to_ray_kernel_bandwidth: f64,
    /// Width (metres) of the kernel by which weights fall with the distance from the hit; 0 for none,
    /// default 0.5.
    pub update_weight_distance_cell_to_hit_kernel_bandwidth: f64,
    /// Maximum number of cells of the field, default 2²⁶.
    pub max_cells: usize,
}

impl Default for TsdfInserterOptions {
    fn default() -> Self {
        Self {
            truncation_distance: 0.3,
            maximum_weight: 10.0,
            update_free_space: false,
            normal_estimation: NormalEstimationOptions::default(),
            project_sdf_distance_to_scan_normal: true,
            update_weight_range_exponent: 0,
            update_weight_angle_scan_normal_to_ray_kernel_bandwidth: 0.5,
            update_weight_distance_cell_to_hit_kernel_bandwidth: 0.5,
            max_cells: DEFAULT_MAX_CELLS,
        }
    }
}

/// Inserts range data into distance fields. All arithmetic is single precision, on which equality at the
/// borders of cells depends.
#[derive(Clone, Debug, PartialEq)]
pub struct TsdfInserter {
    options: TsdfInserterOptions,
    angle_bandwidth: f32,
    distance_bandwidth: f32,
}

/// One ray that ends on a surface.
struct Hit {
    position: Vector2f,
    range: f32,
    /// Product of the weight factors that do not depend on the cell.
    weight: f32,
    /// Unit normal, if distances are projected on it.
    normal: Option<Vector2f>,
}

impl TsdfInserter {
    /// # Errors
    /// If an option is out of its bounds.
    pub fn new(options: &TsdfInserterOptions) -> Result<Self, InserterOptionError> {
        options.normal_estimation.check()?;
        let positive = [
            ("truncation_distance", options.truncation_distance),
            ("maximum_weight", options.maximum_weight),
        ];
        for (name, value) in positive {
            if !(value > 0.0 && value.is_finite()) {
                return Err(InserterOptionError::NotPositive { name, value });
            }
        }
        let angle = options.update_weight_angle_scan_normal_to_ray_kernel_bandwidth;
        let distance = options.update_weight_distance_cell_to_hit_kernel_bandwidth;
        let bandwidths = [
            ("update_weight_angle_scan_normal_to_ray_kernel_bandwidth", angle),
            ("update_weight_distance_cell_to_hit_kernel_bandwidth", distance),
        ];
        for (name, value) in bandwidths {
            if !(value >= 0.0 && value.is_finite()) {
                return Err(InserterOptionError::Negative { name, value });
            }
        }
        Ok(Self {
            options: options.clone(),
            angle_bandwidth: angle as f32,
            distance_bandwidth: distance as f32,
        })
    }

    /// Inserts one scan (metres, in the frame of the field): cells near the ends of rays get their distance
    /// to the surface. A cell changes at most once, by the first ray. The field grows as needed. Misses are
    /// not used.
    ///
    /// # Errors
    /// If the origin is not finite or the field would grow too large; the field remains unchanged.
    pub fn insert(&self, range_data: &RangeData, tsdf: &mut Tsdf2d) -> Result<InsertReport, GridError> {
        let origin = range_data.origin;
        let truncation = tsdf.truncation_distance();
        let mut bounds = Bounds::of_origin(origin)?;
        let mut returns: Vec<Point3f> = Vec::with_capacity(range_data.returns.len());
        for point in range_data.returns.points.iter().filter(|p| is_finite(p)) {
            let ray = point - origin;
            let length = ray.norm();
            if length > 0.0 {
                bounds.extend((point + ray / length * truncation).xy().coords);
                returns.push(*point);
            }
        }
        let finite = range_data.returns.points.iter().filter(|p| is_finite(p)).count();
        tsdf.grow_to_include(&bounds.padded(), self.options.max_cells)?;
        let normals = self.normals(&mut returns, &origin);
        for (i, point) in returns.iter().enumerate() {
            self.insert_hit(origin.xy().coords, point.xy().coords, normals.get(i).copied(), tsdf);
        }
        tsdf.finish_update();
        Ok(InsertReport { hits: finite, not_finite: range_data.returns.len() - finite, outside: 0 })
    }

    /// Sorts the returns and estimates normals, if any weight or distance needs them.
    fn normals(&self, returns: &mut [Point3f], origin: &Point3f) -> Vec<f32> {
        if !self.options.project_sdf_distance_to_scan_normal && self.angle_bandwidth == 0.0 {
            return Vec::new();
        }
        sort_by_direction(returns, origin);
        estimate_normals(returns, origin, &self.options.normal_estimation)
    }

    fn insert_hit(&self, origin: Vector2f, position: Vector2f, normal: Option<f32>, tsdf: &mut Tsdf2d) {
        let ray = position - origin;
        let range = ray.norm();
        let truncation = tsdf.truncation_distance();
        if range < truncation {
            return;
        }
        let ratio = truncation / range;
        let begin = if self.options.update_free_space { origin } else { origin + (1.0 - ratio) * ray };
        let end = origin + (1.0 + ratio) * ray;
        let hit = self.hit(position, ray, range, normal);
        let pixels = SubpixelIndex::for_limits(tsdf.limits());
        for_each_cell_on_ray(pixels.of(begin), pixels.of(end), SUBPIXELS, |x, y| {
            self.update_cell(CellIndex::new(x as i32, y as i32), origin, &hit, tsdf);
        });
    }

    fn hit(&self, position: Vector2f, ray: Vector2f, range: f32, normal: Option<f32>) -> Hit {
        let mut weight = 1.0;
        if let Some(normal) = normal
            && self.angle_bandwidth != 0.0
        {
            let towards_sensor = (-ray.y).atan2(-ray.x);
            weight *= gaussian_kernel(normalized(normal - towards_sensor), self.angle_bandwidth);
        }
        if self.options.update_weight_range_exponent != 0 {
            let power = range.powi(self.options.update_weight_range_exponent);
            weight *= if range > 1e-6 { 1.0 / power } else { 0.0 };
        }
        let projected = normal.filter(|_| self.options.project_sdf_distance_to_scan_normal);
        Hit { position, range, weight, normal: projected.map(|n| Vector2f::new(n.cos(), n.sin())) }
    }

    fn update_cell(&self, cell: CellIndex, origin: Vector2f, hit: &Hit, tsdf: &mut Tsdf2d) {
        if tsdf.is_updated(cell) {
            return;
        }
        let center = tsdf.limits().cell_center(cell).cast::<f32>();
        let truncation = tsdf.truncation_distance();
        let distance = match hit.normal {
            Some(normal) => (center - hit.position).dot(&normal),
            None => hit.range - (center - origin).norm(),
        };
        let update = distance.clamp(-truncation, truncation);
        let mut weight = hit.weight;
        if self.distance_bandwidth != 0.0 {
            weight *= gaussian_kernel(update, self.distance_bandwidth);
        }
        if weight == 0.0 {
            return;
        }
        let old_weight = tsdf.weight(cell);
        let new_weight = old_weight + weight;
        let new = (tsdf.signed_distance(cell) * old_weight + update * weight) / new_weight;
        tsdf.set(cell, new, new_weight.min(tsdf.max_weight()));
    }
}

/// The normal distribution with standard deviation `sigma` at `x`, computed in double precision: the
/// only place where more than single precision is needed for equality.
fn gaussian_kernel(x: f32, sigma: f32) -> f32 {
    let (x, sigma) = (f64::from(x), f64::from(sigma));
    ((-0.5 * x * x / (sigma * sigma)).exp() / ((2.0 * std::f64::consts::PI).sqrt() * sigma)) as f32
}

/// An angle within one revolution of [−π, π], moved into it.
fn normalized(mut angle: f32) -> f32 {
    use std::f32::consts::PI;
    while angle > PI {
        angle -= 2.0 * PI;
    }
    while angle < -PI {
        angle += 2.0 * PI;
    }
    angle
}

#[cfg(test)]
mod tests;
