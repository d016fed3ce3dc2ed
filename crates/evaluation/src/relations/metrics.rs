//! Error of a trajectory with respect to relations (`spec/tools.md` §1.3).

use std::fmt;
use std::io::Write;

use portolan_geometry::{Rigid3, Time, rotation_angle};
use portolan_numeric::format_general;
use serde::Serialize;

use super::Relation;
use crate::statistics::{ErrorStatistics, MeanDeviation};
use crate::{EvaluationError, Histogram, Trajectory};

/// Error of the trajectory with respect to one relation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RelationError {
    /// The relation.
    pub relation: Relation,
    /// Metres.
    pub translation: f64,
    /// Degrees.
    pub rotation_degrees: f64,
}

/// Errors with respect to all relations. Printed as the four lines of Cartographer's tool.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RelationReport {
    /// Number of relations.
    pub count: usize,
    /// Number of relations with a time outside the trajectory; there the nearest end of the trajectory was
    /// used.
    pub outside_trajectory: usize,
    /// Metres.
    pub absolute_translation: MeanDeviation,
    /// Square metres.
    pub squared_translation: MeanDeviation,
    /// Degrees.
    pub absolute_rotation: MeanDeviation,
    /// Square degrees.
    pub squared_rotation: MeanDeviation,
    /// Metres; statistics that Cartographer does not print.
    pub translation: ErrorStatistics,
    /// Degrees; statistics that Cartographer does not print.
    pub rotation_degrees: ErrorStatistics,
    /// Error for each relation, in their order.
    #[serde(skip)]
    pub errors: Vec<RelationError>,
}

/// Compares a trajectory with at least two relations. Poses are interpolated; before the first and after the
/// last pose that pose is used. All times must come from one clock; see
/// [`in_time_base`](super::in_time_base).
///
/// # Errors
/// If the trajectory has no poses, or there are fewer than two relations.
pub fn relation_errors(
    trajectory: &Trajectory,
    relations: &[Relation],
) -> Result<RelationReport, EvaluationError> {
    let (start, end) = trajectory.span().ok_or(EvaluationError::EmptyTrajectory("estimated"))?;
    let inside = |r: &&Relation| [r.time1, r.time2].iter().all(|t| (start..=end).contains(t));
    let outside_trajectory = relations.len() - relations.iter().filter(inside).count();
    let errors: Vec<RelationError> = relations.iter().filter_map(|r| error_of(trajectory, r)).collect();
    let translation = || errors.iter().map(|e| e.translation);
    let rotation = || errors.iter().map(|e| e.rotation_degrees);
    let too_few = || EvaluationError::TooFewRelations(relations.len());
    let statistics = |values: Vec<f64>| ErrorStatistics::of(&values).ok_or_else(too_few);
    Ok(RelationReport {
        count: errors.len(),
        outside_trajectory,
        absolute_translation: MeanDeviation::of(translation()).ok_or_else(too_few)?,
        squared_translation: MeanDeviation::of(translation().map(|e| e * e)).ok_or_else(too_few)?,
        absolute_rotation: MeanDeviation::of(rotation()).ok_or_else(too_few)?,
        squared_rotation: MeanDeviation::of(rotation().map(|e| e * e)).ok_or_else(too_few)?,
        translation: statistics(translation().collect())?,
        rotation_degrees: statistics(rotation().collect())?,
        errors,
    })
}

fn error_of(trajectory: &Trajectory, relation: &Relation) -> Option<RelationError> {
    let map_from_1 = trajectory.lookup_clamped(relation.time1)?;
    let map_from_2 = trajectory.lookup_clamped(relation.time2)?;
    let error: Rigid3 = (map_from_1.inverse() * map_from_2) * relation.expected_1_from_2.inverse();
    Some(RelationError {
        relation: *relation,
        translation: error.translation.vector.norm(),
        rotation_degrees: rotation_angle(&error).to_degrees(),
    })
}

impl fmt::Display for RelationReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "Abs translational error {} m", self.absolute_translation)?;
        writeln!(f, "Sqr translational error {} m^2", self.squared_translation)?;
        writeln!(f, "Abs rotational error {} deg", self.absolute_rotation)?;
        write!(f, "Sqr rotational error {} deg^2", self.squared_rotation)
    }
}

impl RelationReport {
    /// Fraction of relations whose translational error is at most `limit` metres, 0 to 1.
    pub fn share_within(&self, limit: f64) -> f64 {
        let within = self.errors.iter().filter(|e| e.translation <= limit).count();
        within as f64 / self.errors.len().max(1) as f64
    }

    /// Translational errors, metres.
    pub fn translation_histogram(&self) -> Histogram {
        self.errors.iter().map(|e| e.translation).collect()
    }

    /// Rotational errors, degrees.
    pub fn rotation_histogram(&self) -> Histogram {
        self.errors.iter().map(|e| e.rotation_degrees).collect()
    }

    /// Writes the table of Cartographer's tool, one row per relation.
    ///
    /// # Errors
    /// If writing fails.
    pub fn write_csv(&self, writer: impl Write) -> std::io::Result<()> {
        self.write_rows(writer, |_| String::new(), "")
    }

    /// The same, with both times of each relation, seconds since 1970, in front.
    ///
    /// # Errors
    /// If writing fails.
    pub fn write_csv_with_times(&self, writer: impl Write) -> std::io::Result<()> {
        let times = |relation: &Relation| {
            let [first, second] = [relation.time1, relation.time2].map(Time::unix_decimal);
            format!("{first},{second},")
        };
        self.write_rows(writer, times, "time1,time2,")
    }

    fn write_rows(
        &self,
        mut writer: impl Write,
        in_front: impl Fn(&Relation) -> String,
        names_in_front: &str,
    ) -> std::io::Result<()> {
        writeln!(
            writer,
            "{names_in_front}translational_error,squared_translational_error,rotational_errors_degree,\
             squared_rotational_errors_degree,expected_translation_x,expected_translation_y,\
             expected_translation_z,expected_rotation_w,expected_rotation_x,expected_rotation_y,\
             expected_rotation_z,covered_distance"
        )?;
        for e in &self.errors {
            let t = e.relation.expected_1_from_2.translation;
            let q = e.relation.expected_1_from_2.rotation;
            let (d, a) = (e.translation, e.rotation_degrees);
            let row = [d, d * d, a, a * a, t.x, t.y, t.z, q.w, q.i, q.j, q.k, e.relation.covered_distance];
            let row = row.map(|v| format_general(if v.is_nan() { f64::NAN } else { v }, 6)).join(",");
            writeln!(writer, "{}{row}", in_front(&e.relation))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::TimedPose;
    use portolan_geometry::{Time, Vector3};

    fn line() -> Trajectory {
        let pose = |i: i64| TimedPose {
            time: Time::from_ticks(10 * i),
            map_from_tracking: Rigid3::translation(i as f64, 0.0, 0.0),
        };
        Trajectory::new((0..=10).map(pose)).0
    }

    fn relation(from: i64, to: i64, x: f64, yaw: f64) -> Relation {
        Relation {
            time1: Time::from_ticks(from),
            time2: Time::from_ticks(to),
            expected_1_from_2: Rigid3::new(Vector3::new(x, 0.0, 0.0), Vector3::z() * yaw),
            covered_distance: 1234567.0,
        }
    }

    #[test]
    fn results_are_printed_as_by_the_reference() {
        let report = relation_errors(
            &line(),
            &[relation(0, 50, 4.9, 0.0), relation(5, 15, 0.9, 0.0), relation(50, 999, 4.7, 0.0)],
        )
        .unwrap();
        assert_eq!(
            report.to_string(),
            "Abs translational error 0.16667 +/- 0.11547 m\nSqr translational error 0.03667 +/- 0.04619 m^2\n\
             Abs rotational error 0.00000 +/- 0.00000 deg\nSqr rotational error 0.00000 +/- 0.00000 deg^2"
        );
        assert_eq!((report.count, report.outside_trajectory), (3, 1));
        assert!((report.share_within(0.2) - 2.0 / 3.0).abs() < 1e-12);
        let mut csv = Vec::new();
        report.write_csv(&mut csv).unwrap();
        let csv = String::from_utf8(csv).unwrap();
        assert!(csv.starts_with(
            "translational_error,squared_translational_error,rotational_errors_degree,squared_"
        ));
        assert_eq!(csv.lines().nth(1), Some("0.1,0.01,0,0,4.9,0,0,1,0,0,0,1.23457e+06"));
        let mut with_times = Vec::new();
        report.write_csv_with_times(&mut with_times).unwrap();
        let with_times = String::from_utf8(with_times).unwrap();
        for (row, line) in with_times.lines().zip(csv.lines()) {
            assert_eq!(row.splitn(3, ',').last(), Some(line));
        }
    }

    #[test]
    fn turning_is_measured_in_degrees() {
        let report =
            relation_errors(&line(), &[relation(0, 10, 1.0, 0.1), relation(0, 10, 1.0, -0.1)]).unwrap();
        assert!((report.absolute_rotation.mean - 0.1_f64.to_degrees()).abs() < 1e-9);
        assert!((report.squared_rotation.mean - 0.1_f64.to_degrees().powi(2)).abs() < 1e-9);
    }

    #[test]
    fn one_relation_has_no_deviation() {
        let error = relation_errors(&line(), &[relation(0, 50, 5.0, 0.0)]).unwrap_err();
        assert!(matches!(error, EvaluationError::TooFewRelations(1)));
        assert!(relation_errors(&Trajectory::default(), &[]).is_err());
    }
}
