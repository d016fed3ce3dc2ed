//! True surfaces as solid boxes.

use std::io::BufRead;

use super::search::Shape;
use crate::EvaluationError;
use crate::formats::{Lines, bad_line, parse_number};

/// An axis-aligned solid box, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolidBox {
    /// Least corner.
    pub low: [f64; 3],
    /// Greatest corner.
    pub high: [f64; 3],
}

impl SolidBox {
    /// Distance of a point to the surface of the box, from outside or from inside, metres.
    pub fn surface_distance(&self, point: [f64; 3]) -> f64 {
        // Distance outside the box along each axis; negative inside.
        let outside: [f64; 3] =
            std::array::from_fn(|k| (self.low[k] - point[k]).max(point[k] - self.high[k]));
        let deepest = outside[0].max(outside[1]).max(outside[2]);
        if deepest < 0.0 {
            return -deepest;
        }
        outside.iter().map(|v| v.max(0.0).powi(2)).sum::<f64>().sqrt()
    }
}

impl Shape for SolidBox {
    fn bounds(&self) -> [[f64; 3]; 2] {
        [self.low, self.high]
    }

    fn distance(&self, point: [f64; 3]) -> f64 {
        self.surface_distance(point)
    }

    fn numbers(&self) -> [f64; 9] {
        let ([a, b, c], [d, e, f]) = (self.low, self.high);
        [a, b, c, d, e, f, 0.0, 0.0, 0.0]
    }
}

/// Reads boxes, one a line: `x0,y0,z0,x1,y1,z1` in metres; lines that begin with `#` are skipped.
///
/// # Errors
/// If reading fails, a line does not have six numbers, or the corners of a box are swapped.
pub fn read_boxes(reader: impl BufRead) -> Result<Vec<SolidBox>, EvaluationError> {
    let mut lines = Lines::new(reader);
    let mut boxes = Vec::new();
    while let Some((number, line)) = lines.next_data()? {
        let values: Vec<f64> =
            line.split(',').map(|text| parse_number(text.trim(), number)).collect::<Result<_, _>>()?;
        let Ok([x0, y0, z0, x1, y1, z1]) = <[f64; 6]>::try_from(values) else {
            return Err(bad_line(number, "a box has six numbers: x0,y0,z0,x1,y1,z1".to_owned()));
        };
        let solid = SolidBox { low: [x0, y0, z0], high: [x1, y1, z1] };
        if !(0..3).all(|k| solid.low[k] <= solid.high[k]) {
            return Err(bad_line(
                number,
                "the second corner of a box must not be below the first".to_owned(),
            ));
        }
        boxes.push(solid);
    }
    Ok(boxes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_to_faces_edges_and_from_within() {
        let solid = SolidBox { low: [0.0; 3], high: [1.0, 2.0, 3.0] };
        let distance = |x, y, z| solid.surface_distance([x, y, z]);
        assert_eq!((distance(2.0, 1.0, 1.0), distance(0.25, 1.0, 1.0)), (1.0, 0.25));
        assert!((distance(4.0, 6.0, 1.0) - 5.0).abs() < 1e-12);
    }

    #[test]
    fn boxes_are_read_and_bad_lines_named() {
        let boxes = read_boxes(&b"# solid\n0,0,0,1,1,1\n\n-1,-1,-1, 0,0,0\n"[..]).unwrap();
        assert_eq!(boxes.len(), 2);
        for bad in ["1,2,3\n", "0,0,0,-1,1,1\n", "0,0,0,1,1,x\n", "0,0,0,1,1,nan\n"] {
            assert!(read_boxes(bad.as_bytes()).is_err(), "{bad}");
        }
    }
}
