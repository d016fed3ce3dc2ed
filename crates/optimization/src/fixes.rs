//! How much satellite fixes count: by how far they scatter about the poses of nodes.

use portolan_config::OptimizationProblemOptions;
use portolan_geometry::Vector3;
use portolan_numeric::quantile;
use portolan_solver::Loss;

use super::data::{OptimizationData, OptimizationNode};
use super::graph_problem::follows;
use crate::{NodeId, TrajectoryId, of_trajectory};

/// Fewer fixes have no scatter.
const MIN_FIXES: usize = 20;
/// Median absolute deviation of a normal distribution, in standard deviations.
const MEDIAN_DEVIATION: f64 = 0.6745;
/// Beyond so many standard deviations, fixes pull with no more than a constant force (Huber's loss): reflected signals
/// throw them tens of metres away, for seconds.
const OUTLIER: f64 = 3.0;

/// The weight of a translation to a fix, 1/m: as the options say, or less if fixes scatter more than that.
pub(super) fn translation_weight(
    data: &OptimizationData,
    id: TrajectoryId,
    options: &OptimizationProblemOptions,
) -> f64 {
    let usual = options.fixed_frame_pose_translation_weight;
    match scatter(data, id).filter(|_| data.doubts_sensors) {
        Some(sigma) if sigma * usual > 1.0 => 1.0 / sigma,
        _ => usual,
    }
}

/// The loss of ties to the fixed frame.
pub(super) fn loss(data: &OptimizationData, options: &OptimizationProblemOptions) -> Loss {
    if options.fixed_frame_pose_use_tolerant_loss {
        let (a, b) =
            (options.fixed_frame_pose_tolerant_loss_param_a, options.fixed_frame_pose_tolerant_loss_param_b);
        return Loss::Tolerant(a, b);
    }
    if data.doubts_sensors { Loss::Huber(OUTLIER) } else { Loss::None }
}

/// What fixes are off by anew each time: the standard deviation along each axis, metres. From differences of fixes that
/// follow each other, in which slow errors cancel, whether of the fixes or of the map; none before there is a map.
fn scatter(data: &OptimizationData, id: TrajectoryId) -> Option<f64> {
    let map_from_fixed = data.fixed_frame_origins.get(&id).copied().flatten()?;
    let fixes = &data.sensors.get(&id)?.fixed_frame;
    let nodes: Vec<(NodeId, &OptimizationNode)> = of_trajectory(&data.nodes, id).collect();
    let between = nodes.windows(2).filter_map(|pair| {
        let [(id_a, a), (id_b, b)] = pair else { return None };
        if !follows(id_a, id_b) {
            return None;
        }
        let seconds = b.time.seconds_since(a.time);
        (seconds > 0.0).then_some((*a, *b, seconds))
    });
    let errors: Vec<Vector3> = between
        .flat_map(|(a, b, seconds)| {
            let inside = fixes.range(a.time..b.time).filter_map(move |(time, fix)| {
                Some((time.seconds_since(a.time) / seconds, fix.fixed_from_tracking?))
            });
            inside.map(move |(share, fix)| {
                let pose = a.map_from_node.lerp_slerp(&b.map_from_node, share);
                (map_from_fixed * fix).translation.vector - pose.translation.vector
            })
        })
        .collect();
    if errors.len() < MIN_FIXES {
        return None;
    }
    let steps = errors.iter().zip(errors.iter().skip(1)).map(|(a, b)| b - a);
    let mut steps: Vec<f64> = steps.flat_map(|step| [step.x.abs(), step.y.abs(), step.z.abs()]).collect();
    Some(quantile(&mut steps, 0.5)? / (MEDIAN_DEVIATION * std::f64::consts::SQRT_2))
}

#[cfg(test)]
mod tests {
    use portolan_geometry::{Quaternion, Rigid3, Time};
    use portolan_numeric::SplitMix64;
    use portolan_sensor::FixedFramePoseData;

    use super::*;

    const ID: TrajectoryId = TrajectoryId(0);

    /// A straight drive whose fixes are off by this; the map has drifted by a metre on the way.
    fn drive(error: impl Fn(u32) -> f64) -> OptimizationData {
        let mut data = OptimizationData { doubts_sensors: true, ..Default::default() };
        data.fixed_frame_origins.insert(ID, Some(Rigid3::identity()));
        for k in 0..200 {
            let (time, x) = (Time::from_unix_seconds(1e9 + f64::from(k)), 2.0 * f64::from(k));
            let pose = Rigid3::translation(x, 0.005 * f64::from(k), 0.0);
            let node = OptimizationNode {
                time,
                local_from_node: pose,
                map_from_node: pose,
                gravity_alignment: Quaternion::identity(),
            };
            data.nodes.insert(NodeId::new(ID, k), node);
            let fixed_from_tracking = Some(Rigid3::translation(x + error(k), error(k + 7), error(k + 13)));
            data.sensors_mut(ID).fixed_frame.insert(time, FixedFramePoseData { time, fixed_from_tracking });
        }
        data
    }

    #[test]
    fn fixes_count_as_they_scatter_and_neither_drift_nor_jumps_matter() {
        let options =
            OptimizationProblemOptions { fixed_frame_pose_translation_weight: 10.0, ..Default::default() };
        let noise = |k: u32| 2.0 * SplitMix64::new(u64::from(k)).uniform() - 1.0;
        let jump = |k: u32| if (50..60).contains(&k) { 30.0 } else { 0.0 };
        let weight = |data: &OptimizationData| translation_weight(data, ID, &options);
        let sigma = 1.0 / weight(&drive(|k| 4.0 * noise(k) + jump(k)));
        // Differences of numbers that are uniform from -4 to 4 have a median of 2.34 m.
        assert!((2.0..2.7).contains(&sigma), "{sigma}");
        assert_eq!(weight(&drive(|k| 0.05 * noise(k) + jump(k))), 10.0);
        let believing = OptimizationData { doubts_sensors: false, ..drive(|k| 4.0 * noise(k)) };
        assert_eq!(weight(&believing), 10.0);
        assert_eq!(weight(&OptimizationData { doubts_sensors: true, ..Default::default() }), 10.0);
    }
}
