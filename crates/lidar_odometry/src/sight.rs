//! Determines which parts of columns sweeps can have seen from their position.

use portolan_geometry::Vector3;
use portolan_geometry::nalgebra as na;

use crate::correlation::Columns;
use crate::settings::CorrelationSettings;
use crate::settings::constants::sight::{NEAREST_FOR_ELEVATIONS, SECTORS};

/// Limits of sight of sweeps from their position: range in each direction, and elevations. Beyond them the
/// space is unknown.
pub(crate) struct Sight {
    from: Vector3,
    /// Maximum range in each sector, metres.
    farthest: [f64; SECTORS],
    /// Tangents of the elevations of beams.
    lowest: f64,
    highest: f64,
}

impl Sight {
    pub fn of(columns: &Columns, from: &Vector3, settings: &CorrelationSettings) -> Self {
        let mut sight =
            Self { from: *from, farthest: [0.0; SECTORS], lowest: f64::INFINITY, highest: f64::NEG_INFINITY };
        for (place, mask) in columns.filled() {
            let (sector, range) = sight.sector_and_range(&place);
            if let Some(farthest) = sight.farthest.get_mut(sector) {
                *farthest = farthest.max(range);
            }
            if range > NEAREST_FOR_ELEVATIONS {
                let [low, high] = [mask.trailing_zeros(), 63 - mask.leading_zeros()];
                let tangent = |layer: u32| (settings.height_of(layer) - sight.from.z) / range;
                (sight.lowest, sight.highest) =
                    (sight.lowest.min(tangent(low)), sight.highest.max(tangent(high)));
            }
        }
        sight
    }

    fn sector_and_range(&self, place: &na::Vector2<f64>) -> (usize, f64) {
        let ray = place - self.from.xy();
        let turn = about_angle(&ray) / std::f64::consts::TAU;
        ((turn.rem_euclid(1.0) * SECTORS as f64) as usize % SECTORS, ray.norm())
    }

    /// The layers of a column that can have been seen.
    pub fn layers(&self, place: &na::Vector2<f64>, settings: &CorrelationSettings) -> u64 {
        let (sector, range) = self.sector_and_range(place);
        if !self.farthest.get(sector).is_some_and(|farthest| range <= *farthest) {
            return 0;
        }
        let up_to = |tangent: f64| match settings.layer_at(self.from.z + range * tangent) {
            layer if layer <= 0.0 => 0,
            layer if layer >= 63.0 => u64::MAX,
            layer => (2 << layer as u32) - 1,
        };
        up_to(self.highest) & !(up_to(self.lowest) >> 1)
    }
}

/// The angle of a vector to 0.005 rad, by a polynomial: much faster than the arctangent.
fn about_angle(ray: &na::Vector2<f64>) -> f64 {
    let [x, y] = [ray.x.abs(), ray.y.abs()];
    let ratio = x.min(y) / x.max(y).max(f64::MIN_POSITIVE);
    let to_axis = ratio * (0.9724 - 0.1919 * ratio * ratio);
    let in_quadrant = if x >= y { to_axis } else { std::f64::consts::FRAC_PI_2 - to_axis };
    let in_half = if ray.x >= 0.0 { in_quadrant } else { std::f64::consts::PI - in_quadrant };
    in_half.copysign(ray.y)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_are_about_those_of_the_arctangent() {
        for i in 0..1000 {
            let angle = std::f64::consts::TAU * (f64::from(i) / 1000.0 - 0.5);
            let ray = na::Vector2::new(angle.cos(), angle.sin()) * (0.1 + f64::from(i));
            assert!((about_angle(&ray) - angle).abs() < 0.0051, "{angle} {}", about_angle(&ray));
        }
        assert_eq!(about_angle(&na::Vector2::zeros()), 0.0);
    }
}
