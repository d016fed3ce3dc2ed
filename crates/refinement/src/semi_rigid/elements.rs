//! The equations over all elements of the trajectory: each pair of points connects the two elements that
//! measured them.
//!
//! For points p and q of the elements i and j, with the normal n of their surface:
//! `n·(p − q) + n·τ_i + ((p−c_i)×n)·φ_i − n·τ_j − ((q−c_j)×n)·φ_j = 0`, with translation τ and rotation φ of
//! an element about its position c. Equations 7 to 15 of the paper sum this up for whole sections (D and C);
//! here nothing is summed, so no section has to stay rigid.

use portolan_geometry::Vector3;
use rayon::prelude::*;

use crate::continuous::Knots;

/// Number of parts in which pairs are processed, independent of the number of threads.
const PARTS: usize = 8;

/// One end of a pair.
#[derive(Clone, Copy, Debug)]
pub(super) struct End {
    lever: [f32; 3],
    /// Position between its element and the next, 0 to 1.
    fraction: f32,
    element: u32,
}

impl End {
    /// A point at `place` (world), measured at a time from the position `seen_from`.
    pub fn new(
        elements: &Knots,
        seconds: f64,
        place: &Vector3,
        seen_from: &Vector3,
        normal: &Vector3,
    ) -> Self {
        let (element, fraction) = elements.place(seconds);
        let lever = (place - seen_from).cross(normal);
        Self { lever: lever.map(|v| v as f32).into(), fraction: fraction as f32, element: element as u32 }
    }
}

/// A pair of points, linearised.
#[derive(Clone, Copy, Debug)]
pub(super) struct ElementPair {
    pub normal: [f32; 3],
    /// The second enters with the other sign.
    pub ends: [End; 2],
    /// `n·(p − q)`, metres.
    pub residual: f32,
    pub weight: f32,
}

impl ElementPair {
    /// Derivatives with respect to translation and rotation at each end.
    fn jacobians(&self) -> [[f64; 6]; 2] {
        let [x, y, z] = self.normal.map(f64::from);
        let of = |end: &End, sign: f64| {
            let [a, b, c] = end.lever.map(f64::from);
            [x, y, z, a, b, c].map(|v| v * sign)
        };
        [of(&self.ends[0], 1.0), of(&self.ends[1], -1.0)]
    }
}

/// All pairs.
pub(super) struct ElementEquations {
    pairs: Vec<ElementPair>,
    unknowns: usize,
}

impl ElementEquations {
    pub fn new(pairs: Vec<ElementPair>, elements: &Knots) -> Self {
        Self { pairs, unknowns: 6 * elements.count() }
    }

    /// `y += Σ w J Jᵀ x`.
    pub fn multiply(&self, x: &[f64], y: &mut [f64]) {
        self.accumulate(y, |pair, jacobians| {
            pair.ends
                .iter()
                .zip(jacobians)
                .map(|(end, jacobian)| {
                    let at = 6 * end.element as usize;
                    let (from, to) = (&x[at..at + 6], &x[at + 6..at + 12]);
                    let f = f64::from(end.fraction);
                    (0..6).map(|k| jacobian[k] * (from[k] + (to[k] - from[k]) * f)).sum::<f64>()
                })
                .sum()
        });
    }

    /// `y += Σ w J e`.
    pub fn gradient(&self, y: &mut [f64]) {
        self.accumulate(y, |pair, _| f64::from(pair.residual));
    }

    fn accumulate(&self, y: &mut [f64], value: impl Fn(&ElementPair, &[[f64; 6]; 2]) -> f64 + Sync) {
        let parts: Vec<Vec<f64>> = self
            .pairs
            .par_chunks(self.pairs.len().div_ceil(PARTS).max(1))
            .map(|pairs| {
                let mut sum = vec![0.0; self.unknowns];
                for pair in pairs {
                    let jacobians = pair.jacobians();
                    let scaled = f64::from(pair.weight) * value(pair, &jacobians);
                    for (end, jacobian) in pair.ends.iter().zip(&jacobians) {
                        let (at, f) = (6 * end.element as usize, f64::from(end.fraction));
                        for k in 0..6 {
                            sum[at + k] += scaled * (1.0 - f) * jacobian[k];
                            sum[at + 6 + k] += scaled * f * jacobian[k];
                        }
                    }
                }
                sum
            })
            .collect();
        for part in parts {
            y.iter_mut().zip(part).for_each(|(y, v)| *y += v);
        }
    }

    /// Adds the contributions of both ends of the pairs to the blocks on and below the diagonal, row-major
    /// 6×6.
    pub fn add_blocks(&self, diagonal: &mut [[f64; 36]], below: &mut [[f64; 36]]) {
        for pair in &self.pairs {
            for (end, jacobian) in pair.ends.iter().zip(pair.jacobians()) {
                let (element, f) = (end.element as usize, f64::from(end.fraction));
                let w = f64::from(pair.weight);
                for r in 0..6 {
                    for c in 0..6 {
                        let product = w * jacobian[r] * jacobian[c];
                        diagonal[element][6 * r + c] += (1.0 - f) * (1.0 - f) * product;
                        diagonal[element + 1][6 * r + c] += f * f * product;
                        below[element][6 * r + c] += f * (1.0 - f) * product;
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two points on a wall, measured at 0.5 and 2.2 s.
    fn pair(elements: &Knots, moved: &[f64]) -> (ElementPair, f64) {
        let normal = Vector3::new(0.6, 0.0, 0.8);
        let places = [Vector3::new(4.0, 1.0, 2.0), Vector3::new(4.1, 1.2, 1.9)];
        let from = [Vector3::new(1.0, 0.0, 1.0), Vector3::new(2.0, 3.0, 1.0)];
        let seconds = [0.5, 2.2];
        let ends = [0, 1].map(|i| End::new(elements, seconds[i], &places[i], &from[i], &normal));
        let now = [0, 1].map(|i| {
            let (knot, f) = elements.place(seconds[i]);
            let at = |k: usize| moved[6 * knot + k] * (1.0 - f) + moved[6 * knot + 6 + k] * f;
            let turn = Vector3::new(at(3), at(4), at(5));
            places[i] + Vector3::new(at(0), at(1), at(2)) + turn.cross(&(places[i] - from[i]))
        });
        let residual = normal.dot(&(now[0] - now[1]));
        let normal = normal.map(|v| v as f32).into();
        (ElementPair { normal, ends, residual: residual as f32, weight: 2.0 }, residual)
    }

    #[test]
    fn the_gradient_agrees_with_differences() {
        let elements = Knots::new(3.0, 1.0);
        let mut x = vec![0.0; 24];
        let equations = ElementEquations::new(vec![pair(&elements, &x).0], &elements);
        let mut gradient = vec![0.0; 24];
        equations.gradient(&mut gradient);
        let cost = |x: &[f64]| pair(&elements, x).1.powi(2);
        for k in 0..24 {
            x[k] = 1e-5;
            let higher = cost(&x);
            x[k] = -1e-5;
            let numeric = (higher - cost(&x)) / 2e-5;
            x[k] = 0.0;
            assert!((numeric - gradient[k]).abs() < 1e-5, "{k}: {numeric} {}", gradient[k]);
        }
        // H x is the change of the gradient.
        let step: Vec<f64> = (0..24).map(|k| 0.01 * f64::from(k % 7)).collect();
        let (mut product, mut later) = (vec![0.0; 24], vec![0.0; 24]);
        equations.multiply(&step, &mut product);
        ElementEquations::new(vec![pair(&elements, &step).0], &elements).gradient(&mut later);
        for k in 0..24 {
            assert!((later[k] - gradient[k] - product[k]).abs() < 1e-5, "{k}");
        }
    }
}
