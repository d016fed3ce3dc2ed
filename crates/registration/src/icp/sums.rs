//! Sums over the pairs of an iteration.

use nalgebra::Matrix3;
use portolan_geometry::{Rigid3, Vector3};
use rayon::prelude::*;

use super::pairs::{CHUNK, Match, Pairing, moved};
use super::{IcpMethod, IcpOptions};
use crate::linearized::TwistEquations;
use crate::model::Model;
use portolan_spatial::PairMoments;

/// Ratio of the variance along the normal to that along the surface, in generalised ICP (Segal et al. 2009).
const ACROSS: f64 = 1e-3;

/// Sums for the closed forms.
pub(super) fn point_moments<M: Model>(
    pairing: &Pairing<M>,
    pose: &Rigid3,
    matches: &[Match],
    options: &IcpOptions,
) -> PairMoments {
    let parts: Vec<PairMoments> = matches
        .par_chunks(CHUNK)
        .map(|chunk| {
            let mut moments = PairMoments::default();
            for pair in chunk {
                let m = pairing.model.place(pair.model);
                let d = moved(pose, pairing.data.points()[pair.data as usize]);
                moments.add(&m, &d, options.kernel.weight(f64::from(pair.distance)));
            }
            moments
        })
        .collect();
    let mut sum = PairMoments::default();
    parts.iter().for_each(|part| sum.merge(part));
    sum
}

/// Normal equations of the methods with planes, and of point-to-point matching for its covariance.
pub(super) fn equations<M: Model>(
    pairing: &Pairing<M>,
    pose: &Rigid3,
    matches: &[Match],
    options: &IcpOptions,
) -> TwistEquations {
    let (model, data) = (pairing.model, pairing.data);
    let parts: Vec<TwistEquations> = matches
        .par_chunks(CHUNK)
        .map(|chunk| {
            let mut equations = TwistEquations::default();
            for pair in chunk {
                let index = pair.data as usize;
                let m = model.place(pair.model);
                let x = moved(pose, data.points()[index]);
                match options.method {
                    IcpMethod::PointToPoint(_) => {
                        let weight = options.kernel.weight(f64::from(pair.distance));
                        equations.add_weighted(&m, &x, &Matrix3::identity(), weight);
                    }
                    IcpMethod::PointToPlane => {
                        let Some(normal) = model.normal(pair.model) else { continue };
                        let weight = options.kernel.weight(normal.dot(&(m - x)).abs());
                        equations.add_plane(&m, &normal, &x, weight);
                    }
                    IcpMethod::Generalized => {
                        let own = data
                            .surface(index)
                            .map(|s| pose.rotation * Vector3::from(s.normal.map(f64::from)));
                        let spread = shape(model.normal(pair.model)) + shape(own);
                        let Some(information) = spread.try_inverse() else { continue };
                        let weight = options.kernel.weight(f64::from(pair.distance));
                        equations.add_weighted(&m, &x, &information, weight);
                    }
                }
            }
            equations
        })
        .collect();
    let mut sum = TwistEquations::default();
    parts.iter().for_each(|part| sum.merge(part));
    sum
}

/// Covariance of a point on a surface with this normal, in units of the variance along the surface; isotropic
/// without a normal.
fn shape(normal: Option<Vector3>) -> Matrix3<f64> {
    match normal {
        Some(n) => Matrix3::identity() - n * n.transpose() * (1.0 - ACROSS),
        None => Matrix3::identity(),
    }
}
