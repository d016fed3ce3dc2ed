//! The equations of a fine stage: clusters are on planes whose offset and tilt are free.
//!
//! For a cluster j of plane p at time t: `e + n·τ(t) + ((x−c)×n)·φ(t) − (1, a, b)·π = 0`, with e its distance
//! from the plane, c the position of the tracking frame, a and b its coordinates along the plane, and π the
//! change of the plane's offset and two tilts. The planes are eliminated. What remains is
//! `S = Σ w JJᵀ − Σ_p (Σ w J q ᵀ)(Σ w q qᵀ)⁻¹(Σ w q Jᵀ)`, q = (1, a, b), whose products with vectors cost one
//! pass over the clusters and which is never formed. Where sensors are calibrated, J has seven more columns
//! for each: `n·R ρ + ((x−o)×n)·R θ + n·(v + ω×(x−c)) δ` for a translation ρ and a rotation θ of the sensor
//! about its position o, and a delay δ of its clock.

use nalgebra::{Matrix3, Matrix6, Vector6};
use portolan_geometry::Vector3;
use rayon::prelude::*;

use super::correction::Corrections;
use super::pairs::PlacedSurfel;
use super::planes::PlaneGroups;
use super::surfels::SurfelMap;
use super::unknowns::{PER_SENSOR, SensorUnknowns};
use super::{DenseTrajectory, Knots};
use crate::MAX_SENSORS;

/// Number of standard deviations above which residuals lose weight (Cauchy).
const ROBUST: f64 = 2.0;
/// Minimum standard deviation of a point across its surface, metres.
const LEAST_DEVIATION: f64 = 0.005;
/// Standard deviation of a cluster that does not decrease with more points, metres: surfaces are not exact
/// planes.
const UNEVENNESS: f64 = 0.003;
/// Number of parts in which clusters are processed, independent of the number of threads.
const PARTS: usize = 16;

#[derive(Clone, Copy, Debug)]
struct Row {
    lever: [f32; 3],
    a: f32,
    b: f32,
    residual: f32,
    weight: f32,
    fraction: f32,
    knot: u32,
}

/// Derivative of the residual of a row with respect to the sensor that measured it.
#[derive(Clone, Copy, Debug)]
struct SensorRow {
    jacobian: [f32; PER_SENSOR],
    /// Index among the calibrated sensors; none for the others.
    column: Option<u8>,
}

#[derive(Clone, Debug)]
struct Plane {
    normal: Vector3,
    rows: std::ops::Range<usize>,
    /// Inverse of Σ w q qᵀ.
    inverse: Matrix3<f64>,
}

/// The linearised plane terms at the current trajectory.
pub(crate) struct PlaneEquations {
    rows: Vec<Row>,
    /// One for each row, or none if no sensor is calibrated.
    sensor_rows: Vec<SensorRow>,
    planes: Vec<Plane>,
    parts: Vec<std::ops::Range<usize>>,
    /// Number of unknowns of the knots, which come before those of the sensors.
    knot_unknowns: usize,
    unknowns: usize,
    /// Root of the weighted mean square distance of points from their planes, metres.
    pub rms: f64,
    /// Factor for variances that follow from the weights: the clusters of one patch share its errors.
    pub variance_factor: f64,
}

/// The state at which the equations are linearised.
pub(crate) struct State<'a> {
    pub map: &'a SurfelMap,
    pub placed: &'a [PlacedSurfel],
    pub corrections: &'a Corrections,
    pub trajectory: &'a DenseTrajectory,
    pub knots: &'a Knots,
    pub sensors: &'a SensorUnknowns,
}

impl PlaneEquations {
    pub fn new(state: &State, groups: &PlaneGroups) -> Self {
        let columns = state.sensors.columns();
        let parts: Vec<PlaneRows> = groups
            .planes
            .par_iter()
            .map(|range| plane_rows(state, &groups.surfels[range.clone()], &columns))
            .collect();
        let knot_unknowns = 6 * state.knots.count();
        let mut equations = Self {
            rows: Vec::new(),
            sensor_rows: Vec::new(),
            planes: Vec::new(),
            parts: Vec::new(),
            knot_unknowns,
            unknowns: knot_unknowns + state.sensors.size(),
            rms: 0.0,
            variance_factor: 1.0,
        };
        let (mut squares, mut weights) = (0.0, 0.0);
        for part in parts.into_iter().filter(|p| p.rows.len() > 1) {
            squares += part.squares;
            weights += part.weights;
            let start = equations.rows.len();
            equations.rows.extend(part.rows);
            equations.sensor_rows.extend(part.sensor_rows);
            let rows = start..equations.rows.len();
            equations.planes.push(Plane { normal: part.normal, rows, inverse: part.inverse });
        }
        equations.rms = (squares / f64::max(weights, 1e-12)).sqrt();
        let redundancy = equations.rows.len() as f64 - 3.0 * equations.planes.len() as f64;
        let clusters_of_a_patch = equations.rows.len() as f64 / groups.surfels.len().max(1) as f64;
        equations.variance_factor = (squares / redundancy.max(1.0)).max(1.0) * clusters_of_a_patch.max(1.0);
        equations.split();
        equations
    }

    /// Splits the planes into parts with about equally many rows.
    fn split(&mut self) {
        let wanted = self.rows.len().div_ceil(PARTS).max(1);
        let mut start = 0;
        for (i, plane) in self.planes.iter().enumerate() {
            let first = self.planes[start].rows.start;
            if plane.rows.end - first >= wanted || i + 1 == self.planes.len() {
                self.parts.push(start..i + 1);
                start = i + 1;
            }
        }
    }

    /// Number of clusters in planes.
    pub fn clusters(&self) -> usize {
        self.rows.len()
    }

    /// `y += S x`.
    pub fn multiply(&self, x: &[f64], y: &mut [f64]) {
        self.accumulate(y, |plane, i| self.along(plane, i, x));
    }

    /// `y += Σ w J (e − q π)`: the gradient, with the planes at their best.
    pub fn gradient(&self, y: &mut [f64]) {
        self.accumulate(y, |_, i| f64::from(self.rows[i].residual));
    }

    fn accumulate(&self, y: &mut [f64], value: impl Fn(&Plane, usize) -> f64 + Sync) {
        let parts: Vec<Vec<f64>> = self
            .parts
            .par_iter()
            .map(|part| {
                let mut sum = vec![0.0; self.unknowns];
                for plane in &self.planes[part.clone()] {
                    self.accumulate_plane(plane, &value, &mut sum);
                }
                sum
            })
            .collect();
        for part in parts {
            for (y, v) in y.iter_mut().zip(part) {
                *y += v;
            }
        }
    }

    fn accumulate_plane(&self, plane: &Plane, value: impl Fn(&Plane, usize) -> f64, sum: &mut [f64]) {
        let mut u = Vector3::zeros();
        for i in plane.rows.clone() {
            let row = &self.rows[i];
            u += q(row) * (f64::from(row.weight) * value(plane, i));
        }
        let change = plane.inverse * u;
        for i in plane.rows.clone() {
            let row = &self.rows[i];
            let scaled = f64::from(row.weight) * (value(plane, i) - q(row).dot(&change));
            let f = f64::from(row.fraction);
            let at = 6 * row.knot as usize;
            let jacobian = jacobian(plane, row);
            for k in 0..6 {
                sum[at + k] += scaled * (1.0 - f) * jacobian[k];
                sum[at + 6 + k] += scaled * f * jacobian[k];
            }
            if let Some((at, jacobian)) = self.sensor_part(i) {
                for k in 0..PER_SENSOR {
                    sum[at + k] += scaled * f64::from(jacobian[k]);
                }
            }
        }
    }

    /// Index of the first unknown of a row's sensor, and the Jacobian with respect to these unknowns.
    #[inline]
    fn sensor_part(&self, row: usize) -> Option<(usize, &[f32; PER_SENSOR])> {
        let sensor = self.sensor_rows.get(row)?;
        let column = usize::from(sensor.column?);
        Some((self.knot_unknowns + PER_SENSOR * column, &sensor.jacobian))
    }

    /// Change of the residual of a row along x.
    #[inline]
    fn along(&self, plane: &Plane, index: usize, x: &[f64]) -> f64 {
        let row = &self.rows[index];
        let at = 6 * row.knot as usize;
        let (from, to) = (&x[at..at + 6], &x[at + 6..at + 12]);
        let f = f64::from(row.fraction);
        let jacobian = jacobian(plane, row);
        let moved: f64 = (0..6).map(|k| jacobian[k] * (from[k] + (to[k] - from[k]) * f)).sum();
        let calibrated = self
            .sensor_part(index)
            .map_or(0.0, |(at, jacobian)| (0..PER_SENSOR).map(|k| f64::from(jacobian[k]) * x[at + k]).sum());
        moved + calibrated
    }

    /// Σ w JJᵀ of the rows within each interval of `seconds` seconds: the information of the surfaces
    /// measured then.
    pub fn information(&self, knots: &Knots, seconds: f64) -> Vec<Matrix6<f64>> {
        let last = knots.seconds(knots.count() - 1);
        let mut sums = vec![Matrix6::zeros(); (last / seconds).ceil().max(1.0) as usize];
        let count = sums.len();
        for plane in &self.planes {
            for row in &self.rows[plane.rows.clone()] {
                let at = knots.seconds(row.knot as usize) + f64::from(row.fraction) * knots.spacing();
                let j = Vector6::from(jacobian(plane, row));
                sums[((at / seconds) as usize).min(count - 1)] += j * j.transpose() * f64::from(row.weight);
            }
        }
        sums
    }

    /// Adds Σ w JJᵀ (without the planes) to the blocks of a block-tridiagonal matrix: diagonal blocks and those
    /// below them, row-major 6×6.
    pub fn add_blocks(&self, diagonal: &mut [[f64; 36]], below: &mut [[f64; 36]]) {
        for plane in &self.planes {
            for row in &self.rows[plane.rows.clone()] {
                let (w, f) = (f64::from(row.weight), f64::from(row.fraction));
                let (j, knot) = (jacobian(plane, row), row.knot as usize);
                let (w00, w01, w11) = (w * (1.0 - f) * (1.0 - f), w * f * (1.0 - f), w * f * f);
                for r in 0..6 {
                    for c in 0..6 {
                        let product = j[r] * j[c];
                        diagonal[knot][6 * r + c] += w00 * product;
                        diagonal[knot + 1][6 * r + c] += w11 * product;
                        below[knot][6 * r + c] += w01 * product;
                    }
                }
            }
        }
    }
}

fn q(row: &Row) -> Vector3 {
    Vector3::new(1.0, f64::from(row.a), f64::from(row.b))
}

fn jacobian(plane: &Plane, row: &Row) -> [f64; 6] {
    let [x, y, z] = row.lever.map(f64::from);
    [plane.normal.x, plane.normal.y, plane.normal.z, x, y, z]
}

struct PlaneRows {
    rows: Vec<Row>,
    sensor_rows: Vec<SensorRow>,
    normal: Vector3,
    inverse: Matrix3<f64>,
    squares: f64,
    weights: f64,
}

/// Initial plane: the mean of its surfels, weighted by their points.
struct MeanPlane {
    normal: Vector3,
    /// Two directions in the plane.
    along: [Vector3; 2],
    centre: Vector3,
    /// Variance of points across their surfels.
    variance: f64,
}

impl MeanPlane {
    fn of(state: &State, surfels: &[u32]) -> Self {
        let State { map, placed, .. } = state;
        let (mut normal, mut centre, mut variance, mut points) =
            (Vector3::zeros(), Vector3::zeros(), 0.0, 0.0);
        for surfel in surfels.iter().map(|s| *s as usize) {
            let count = map.surfels[surfel].count;
            normal += placed[surfel].normal * count;
            centre += placed[surfel].mean * count;
            variance += map.surfels[surfel].variance * count;
            points += count;
        }
        let normal = normal.normalize();
        centre /= points;
        let variance = (variance / points).max(LEAST_DEVIATION * LEAST_DEVIATION);
        let u = if normal.x.abs() < 0.7 { normal.cross(&Vector3::x()) } else { normal.cross(&Vector3::y()) };
        let u = u.normalize();
        Self { normal, along: [u, normal.cross(&u)], centre, variance }
    }
}

/// Fits the plane to its clusters with robust weights, and linearises.
fn plane_rows(state: &State, surfels: &[u32], columns: &[Option<usize>; MAX_SENSORS]) -> PlaneRows {
    let mean = MeanPlane::of(state, surfels);
    let normal = mean.normal;
    let (mut rows, mut sensor_rows) = (Vec::new(), Vec::new());
    for surfel in surfels {
        let surfel = &state.map.surfels[*surfel as usize];
        let sensor = usize::from(surfel.sensor);
        let first = surfel.first_cluster as usize;
        for cluster in &state.map.clusters[first..first + surfel.cluster_count as usize] {
            let (seconds, in_tracking) =
                state.corrections.place(sensor, cluster.seconds, cluster.in_tracking);
            let variance = mean.variance / f64::from(cluster.count) + UNEVENNESS * UNEVENNESS;
            rows.push(cluster_row(state, &mean, seconds, in_tracking, variance));
            if !state.sensors.is_empty() {
                sensor_rows.push(sensor_row(state, columns[sensor], seconds, in_tracking, &normal));
            }
        }
    }
    let (plane, inverse) = fit(&mut rows);
    let (mut squares, mut weights) = (0.0, 0.0);
    for row in &mut rows {
        let e = f64::from(row.residual) - q(row).dot(&plane);
        squares += f64::from(row.weight) * e * e;
        weights += f64::from(row.weight);
        row.residual = e as f32;
    }
    PlaneRows { rows, sensor_rows, normal, inverse, squares, weights }
}

/// The row of a cluster relative to the mean plane. Its weight field holds the variance at first.
fn cluster_row(state: &State, plane: &MeanPlane, seconds: f64, in_tracking: [f32; 3], variance: f64) -> Row {
    let pose = state.trajectory.pose(seconds);
    let from_sensor = pose.rotation * Vector3::from(in_tracking.map(f64::from));
    let from_centre = from_sensor + (pose.translation.vector - plane.centre);
    let lever = from_sensor.cross(&plane.normal);
    let (knot, fraction) = state.knots.place(seconds);
    Row {
        lever: [lever.x as f32, lever.y as f32, lever.z as f32],
        a: from_centre.dot(&plane.along[0]) as f32,
        b: from_centre.dot(&plane.along[1]) as f32,
        residual: from_centre.dot(&plane.normal) as f32,
        weight: variance as f32,
        fraction: fraction as f32,
        knot: knot as u32,
    }
}

/// Fits offset and tilts of a plane by iteratively reweighted least squares, which turns the variances of the
/// rows into weights. Returns them and the inverse of their normal matrix.
fn fit(rows: &mut [Row]) -> (Vector3, Matrix3<f64>) {
    let variances: Vec<f64> = rows.iter().map(|r| f64::from(r.weight)).collect();
    let mut plane = Vector3::zeros();
    let mut inverse = Matrix3::identity();
    for _ in 0..3 {
        let (mut matrix, mut vector) = (Matrix3::zeros(), Vector3::zeros());
        for (row, variance) in rows.iter_mut().zip(&variances) {
            let e = f64::from(row.residual) - q(row).dot(&plane);
            let weight = 1.0 / (variance * (1.0 + e * e / (ROBUST * ROBUST * variance)));
            row.weight = weight as f32;
            matrix += q(row) * q(row).transpose() * weight;
            vector += q(row) * (weight * f64::from(row.residual));
        }
        // Tilts of planes measured only along a line do not change.
        let slack = matrix.m11 * 1e-4;
        matrix.m22 += slack;
        matrix.m33 += slack;
        inverse = matrix.try_inverse().unwrap_or_else(Matrix3::zeros);
        plane = inverse * vector;
    }
    (plane, inverse)
}

/// The part of a row with respect to its sensor.
fn sensor_row(
    state: &State,
    column: Option<usize>,
    seconds: f64,
    in_tracking: [f32; 3],
    normal: &Vector3,
) -> SensorRow {
    let Some(column) = column else { return SensorRow { jacobian: [0.0; PER_SENSOR], column: None } };
    let pose = state.trajectory.pose(seconds);
    let p = Vector3::from(in_tracking.map(f64::from));
    let n = pose.rotation.inverse() * normal;
    let turn = (p - state.sensors.origins[column]).cross(&n);
    let (velocity, turning) = state.trajectory.velocity(seconds);
    let along = normal.dot(&(velocity + turning.cross(&(pose.rotation * p))));
    let jacobian = [n.x, n.y, n.z, turn.x, turn.y, turn.z, along].map(|v| v as f32);
    SensorRow { jacobian, column: Some(column as u8) }
}
