//! Distinguishes floors of a building by the heights of a trajectory (`tools.md` §3).

use portolan_geometry::{Rigid3, Time};

use super::PointsError;

/// Deviation from the median height of a span at which the span ends, metres.
const NEW_SPAN: f64 = 2.5;
/// Difference of median heights below which spans are at one level, metres.
const SAME_LEVEL: f64 = 1.0;
/// Path length below which a span counts as stairs or a lift, metres.
const SHORT: f64 = 25.0;

/// A floor, with the times at which the trajectory was on it.
#[derive(Clone, Debug, PartialEq)]
pub struct Floor {
    /// First and last time of each stay, ascending.
    pub intervals: Vec<(Time, Time)>,
    /// Height of the tracking frame, metres.
    pub z: f64,
}

impl Floor {
    /// Whether a time is in one of the stays.
    pub fn contains(&self, time: Time) -> bool {
        self.intervals.iter().any(|(start, end)| (*start..=*end).contains(&time))
    }
}

/// Consecutive poses: `[first, end)`.
#[derive(Clone, Copy, Debug)]
struct Span {
    first: usize,
    end: usize,
    /// Median height, metres.
    z: f64,
    is_long: bool,
}

/// Finds the floors of a trajectory, from the lowest. Long spans at the same height are one floor. A short
/// span belongs to the floor at its height, or else to the floors before and after it.
///
/// # Errors
/// If no part of the trajectory stays on a floor for 25 m.
pub fn detect_floors(trajectory: &[(Time, Rigid3)]) -> Result<Vec<Floor>, PointsError> {
    let spans = spans(trajectory);
    let levels = levels(&spans);
    // Indexed by level; none for levels with short spans only.
    let mut floors: Vec<Option<Vec<usize>>> = vec![None; spans.len()];
    for (i, level) in levels.iter().enumerate() {
        if spans[i].is_long {
            floors[*level].get_or_insert_default().push(i);
        }
    }
    for i in (0..spans.len()).filter(|i| !spans[*i].is_long) {
        let own = levels[i];
        let neighbours = [i.checked_sub(1), Some(i + 1).filter(|n| *n < spans.len())];
        let mut joined: Vec<usize> = match floors[own] {
            Some(_) => vec![own],
            None => neighbours.into_iter().flatten().map(|n| levels[n]).collect(),
        };
        joined.dedup();
        for level in joined {
            if let Some(floor) = &mut floors[level] {
                floor.push(i);
            }
        }
    }
    let mut found: Vec<Floor> =
        floors.into_iter().flatten().map(|members| floor(trajectory, &spans, members)).collect();
    if found.is_empty() {
        return Err(PointsError::Floors("All spans in level are short"));
    }
    found.sort_by(|a, b| a.z.total_cmp(&b.z));
    Ok(found)
}

fn floor(trajectory: &[(Time, Rigid3)], spans: &[Span], mut members: Vec<usize>) -> Floor {
    members.sort_unstable();
    let long = members.iter().filter(|i| spans[**i].is_long);
    let heights = long.flat_map(|i| trajectory[spans[*i].first..spans[*i].end].iter().map(height));
    let z = median(heights.collect());
    let intervals = members.iter().map(|i| (trajectory[spans[*i].first].0, trajectory[spans[*i].end - 1].0));
    Floor { z, intervals: intervals.collect() }
}

fn height((_, pose): &(Time, Rigid3)) -> f64 {
    pose.translation.z
}

fn median(mut values: Vec<f64>) -> f64 {
    portolan_numeric::median(&mut values).unwrap_or(0.0)
}

fn spans(trajectory: &[(Time, Rigid3)]) -> Vec<Span> {
    let mut spans = Vec::new();
    // Heights of the span so far, ascending.
    let (mut heights, mut first): (Vec<f64>, usize) = (Vec::new(), 0);
    for (i, z) in trajectory.iter().map(height).enumerate() {
        if let Some(middle) = heights.get(heights.len() / 2)
            && (middle - z).abs() > NEW_SPAN
        {
            spans.push(span(trajectory, first, i));
            heights.clear();
            first = i;
        }
        let place = heights.partition_point(|h| h.total_cmp(&z).is_lt());
        heights.insert(place, z);
    }
    if first < trajectory.len() {
        spans.push(span(trajectory, first, trajectory.len()));
    }
    spans
}

fn span(trajectory: &[(Time, Rigid3)], first: usize, end: usize) -> Span {
    let part = &trajectory[first..end];
    let steps = part.windows(2).map(|w| (w[1].1.translation.vector - w[0].1.translation.vector).xy().norm());
    Span { first, end, z: median(part.iter().map(height).collect()), is_long: steps.sum::<f64>() >= SHORT }
}

/// For each span the index of the first span at its level, directly or through a chain of others.
fn levels(spans: &[Span]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..spans.len()).collect();
    order.sort_by(|a, b| spans[*a].z.total_cmp(&spans[*b].z));
    let mut levels: Vec<usize> = (0..spans.len()).collect();
    for group in order.chunk_by(|a, b| spans[*b].z - spans[*a].z < SAME_LEVEL) {
        let first = group.iter().copied().min().unwrap_or(0);
        group.iter().for_each(|i| levels[*i] = first);
    }
    levels
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A path of `steps` metres at each height, with poses one metre and one second apart.
    fn walk(parts: &[(f64, usize)]) -> Vec<(Time, Rigid3)> {
        let heights = parts.iter().flat_map(|(z, steps)| vec![*z; *steps]);
        let pose = |(i, z): (usize, f64)| {
            (Time::from_ticks(10_000_000 * i as i64), Rigid3::translation(i as f64, 0.0, z))
        };
        heights.enumerate().map(pose).collect()
    }

    #[test]
    fn floors_are_separated_and_stairs_belong_to_both() {
        let walk = walk(&[(0.0, 40), (3.0, 10), (6.0, 50), (0.2, 30)]);
        let floors = detect_floors(&walk).unwrap();
        let second = |s: i64| Time::from_ticks(10_000_000 * s);
        assert_eq!(floors.len(), 2);
        assert_eq!(
            floors[0].intervals,
            [(second(0), second(39)), (second(40), second(49)), (second(100), second(129))]
        );
        assert_eq!(floors[1].intervals, [(second(40), second(49)), (second(50), second(99))]);
        assert!(floors[0].z < 0.3 && (floors[1].z - 6.0).abs() < 1e-9);
        assert!(floors[1].contains(second(45)) && !floors[1].contains(second(10)));
    }

    #[test]
    fn a_short_path_is_no_floor() {
        assert!(matches!(detect_floors(&walk(&[(0.0, 10), (5.0, 10)])), Err(PointsError::Floors(_))));
        assert!(matches!(detect_floors(&[]), Err(PointsError::Floors(_))));
    }
}
