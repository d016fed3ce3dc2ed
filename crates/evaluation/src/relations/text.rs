//! Relations as text: `time1 time2 x y z roll pitch yaw`.

use std::io::{BufRead, Write};

use portolan_geometry::{Rigid3, nalgebra as na, roll_pitch_yaw, rotation_from_roll_pitch_yaw};

use super::Relation;
use crate::EvaluationError;
use crate::formats::{Lines, bad_line, parse_number, parse_time};

const FIELDS: usize = 8;

/// Reads records of eight numbers, separated by any white space: two times in seconds, translation in metres,
/// rotation `Rz(yaw) Ry(pitch) Rx(roll)` in radians. The rest of a line after `#` is a comment.
///
/// # Errors
/// If reading fails, a field is no number, or the last record is cut off.
pub fn read_text_relations(reader: impl BufRead) -> Result<Vec<Relation>, EvaluationError> {
    let mut lines = Lines::new(reader);
    let mut relations = Vec::new();
    let mut record: Vec<String> = Vec::with_capacity(FIELDS);
    let mut last_line = 0;
    while let Some((number, line)) = lines.next_line()? {
        last_line = number;
        let data = line.split('#').next().unwrap_or_default();
        for field in data.split_ascii_whitespace() {
            record.push(field.to_owned());
            if record.len() == FIELDS {
                relations.push(parse_record(&record, number)?);
                record.clear();
            }
        }
    }
    if record.is_empty() {
        return Ok(relations);
    }
    let reason = format!("the file ends after {} of the {FIELDS} numbers of a relation", record.len());
    Err(bad_line(last_line, reason))
}

fn parse_record(record: &[String], line: usize) -> Result<Relation, EvaluationError> {
    let mut values = [0.0; FIELDS];
    for (value, field) in values.iter_mut().zip(record) {
        *value = parse_number(field, line)?;
        if !value.is_finite() {
            return Err(bad_line(line, format!("\"{field}\" is not a finite number")));
        }
    }
    let time = |index: usize| parse_time(record.get(index).map_or("", String::as_str), line);
    let [_, _, x, y, z, roll, pitch, yaw] = values;
    let rotation = rotation_from_roll_pitch_yaw(roll, pitch, yaw);
    Ok(Relation {
        time1: time(0)?,
        time2: time(1)?,
        expected_1_from_2: Rigid3::from_parts(na::Translation3::new(x, y, z), rotation),
        covered_distance: 0.0,
    })
}

/// Writes one relation per line. The format has no field for covered distances.
///
/// # Errors
/// If writing fails.
pub fn write_text_relations(relations: &[Relation], mut writer: impl Write) -> std::io::Result<()> {
    for relation in relations {
        let t = relation.expected_1_from_2.translation;
        let (roll, pitch, yaw) = roll_pitch_yaw(&relation.expected_1_from_2.rotation);
        writeln!(
            writer,
            "{} {} {:.6} {:.6} {:.6} {roll:.9} {pitch:.9} {yaw:.9}",
            relation.time1.unix_decimal(),
            relation.time2.unix_decimal(),
            t.x,
            t.y,
            t.z
        )?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn read(text: &str) -> Result<Vec<Relation>, EvaluationError> {
        read_text_relations(text.as_bytes())
    }

    #[test]
    fn records_of_any_layout_are_read() {
        let text = "# made by hand\n90.239599 90.719599 0.42233 -0.00075 0 0 0 0.01726 # first\n\n1 2 3\n4 5 0 0\t-0.5\n";
        let relations = read(text).unwrap();
        assert_eq!(relations.len(), 2);
        assert_eq!(relations[0].time1.unix_decimal(), "90.2395990");
        assert!((relations[0].expected_1_from_2.translation.x - 0.42233).abs() < 1e-12);
        assert!((roll_pitch_yaw(&relations[1].expected_1_from_2.rotation).2 + 0.5).abs() < 1e-12);
        let mut written = Vec::new();
        write_text_relations(&relations, &mut written).unwrap();
        let again = read_text_relations(&written[..]).unwrap();
        assert!(
            (again[1].expected_1_from_2.inverse() * relations[1].expected_1_from_2).translation.vector.norm()
                < 1e-6
        );
        assert!(read("").unwrap().is_empty());
    }

    #[test]
    fn damage_is_named() {
        assert!(read("1 2 3 4 5 6 7\n").unwrap_err().to_string().contains("ends after 7 of the 8"));
        assert!(read("1 2 3 4 5 six 7 8\n").unwrap_err().to_string().contains("line 1: \"six\""));
        assert!(read("1 2 3 4 5 nan 7 8\n").unwrap_err().to_string().contains("finite"));
        assert!(read("1e18 2 3 4 5 6 7 8\n").unwrap_err().to_string().contains("nanoseconds"));
    }

    proptest! {
        #[test]
        fn any_text_is_read_or_refused(text in "[-0-9. \n#e+a]{0,200}") {
            let _ = read(&text);
        }

        #[test]
        fn any_bytes_are_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = super::super::read_relations(&bytes);
        }
    }
}
