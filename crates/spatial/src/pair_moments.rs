//! Sums over pairs of points that are sufficient for every closed form.

use nalgebra::Matrix3;
use portolan_geometry::Vector3;

/// Weighted sums over pairs of a model point m and a data point d (metres, both in one frame).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PairMoments {
    /// Σ w.
    pub weight: f64,
    /// Number of pairs.
    pub count: u64,
    /// Σ w d.
    pub data: Vector3,
    /// Σ w m.
    pub model: Vector3,
    /// Σ w d dᵀ.
    pub data_data: Matrix3<f64>,
    /// Σ w d mᵀ.
    pub data_model: Matrix3<f64>,
    /// Σ w |m − d|².
    pub squared_distance: f64,
}

impl PairMoments {
    /// Adds a pair.
    pub fn add(&mut self, model: &Vector3, data: &Vector3, weight: f64) {
        self.weight += weight;
        self.count += 1;
        self.data += data * weight;
        self.model += model * weight;
        self.data_data += data * data.transpose() * weight;
        self.data_model += data * model.transpose() * weight;
        self.squared_distance += (model - data).norm_squared() * weight;
    }

    /// Adds the pairs of other sums.
    pub fn merge(&mut self, other: &Self) {
        self.weight += other.weight;
        self.count += other.count;
        self.data += other.data;
        self.model += other.model;
        self.data_data += other.data_data;
        self.data_model += other.data_model;
        self.squared_distance += other.squared_distance;
    }

    /// Centroids of data and model.
    pub fn centroids(&self) -> (Vector3, Vector3) {
        let weight = self.weight.max(f64::MIN_POSITIVE);
        (self.data / weight, self.model / weight)
    }

    /// Σ w (d − d̄)(m − m̄)ᵀ.
    pub fn centred_data_model(&self) -> Matrix3<f64> {
        let (data, model) = self.centroids();
        self.data_model - data * model.transpose() * self.weight
    }

    /// Σ w (d − d̄)(d − d̄)ᵀ.
    pub fn centred_data_data(&self) -> Matrix3<f64> {
        let (data, _) = self.centroids();
        self.data_data - data * data.transpose() * self.weight
    }

    /// Root mean square distance of the pairs, metres.
    pub fn rms(&self) -> f64 {
        (self.squared_distance / self.weight.max(f64::MIN_POSITIVE)).sqrt()
    }
}
