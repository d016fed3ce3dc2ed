//! Point clouds in memory.

/// Values that points have besides their position.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Attributes {
    /// Whether they have an intensity.
    pub intensity: bool,
    /// Whether they have a time.
    pub time: bool,
    /// Whether they have a colour.
    pub color: bool,
}

/// Positions of points, metres.
#[derive(Clone, Debug, PartialEq)]
pub enum Positions {
    /// In double precision.
    Double(Vec<[f64; 3]>),
    /// In single precision, relative to an offset: half the memory, exact to 8 µm within 100 m of it.
    Single {
        /// Position of the offset, metres.
        offset: [f64; 3],
        /// Positions relative to the offset, metres.
        values: Vec<[f32; 3]>,
    },
}

/// Points, stored as columns of their values.
#[derive(Clone, Debug, PartialEq)]
pub struct PointCloud {
    positions: Positions,
    attributes: Attributes,
    intensities: Vec<f32>,
    times: Vec<f64>,
    colors: Vec<[u8; 3]>,
}

impl Default for PointCloud {
    fn default() -> Self {
        Self::new(Attributes::default())
    }
}

impl PointCloud {
    /// An empty cloud in double precision.
    pub fn new(attributes: Attributes) -> Self {
        Self::with_positions(Positions::Double(Vec::new()), attributes)
    }

    /// An empty cloud in single precision relative to an offset (metres).
    pub fn single(offset: [f64; 3], attributes: Attributes) -> Self {
        Self::with_positions(Positions::Single { offset, values: Vec::new() }, attributes)
    }

    fn with_positions(positions: Positions, attributes: Attributes) -> Self {
        Self { positions, attributes, intensities: Vec::new(), times: Vec::new(), colors: Vec::new() }
    }

    /// Adds a point; values of intensity, time (seconds) and colour are stored if the cloud has this attribute.
    pub fn push(&mut self, position: [f64; 3], intensity: f32, time: f64, color: [u8; 3]) {
        match &mut self.positions {
            Positions::Double(positions) => positions.push(position),
            Positions::Single { offset, values } => {
                let ([x, y, z], [a, b, c]) = (position, *offset);
                values.push([x - a, y - b, z - c].map(|v| v as f32));
            }
        }
        if self.attributes.intensity {
            self.intensities.push(intensity);
        }
        if self.attributes.time {
            self.times.push(time);
        }
        if self.attributes.color {
            self.colors.push(color);
        }
    }

    /// Adds all points of another cloud; values that it lacks become 0.
    pub fn extend(&mut self, other: &Self) {
        for i in 0..other.len() {
            self.push(
                other.position(i),
                other.intensity(i).unwrap_or(0.0),
                other.time(i).unwrap_or(0.0),
                other.color(i).unwrap_or([0; 3]),
            );
        }
    }

    /// Removes all points and sets the attributes of the next ones; memory is kept.
    pub fn reset(&mut self, attributes: Attributes) {
        match &mut self.positions {
            Positions::Double(positions) => positions.clear(),
            Positions::Single { values, .. } => values.clear(),
        }
        self.attributes = attributes;
        self.intensities.clear();
        self.times.clear();
        self.colors.clear();
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        match &self.positions {
            Positions::Double(positions) => positions.len(),
            Positions::Single { values, .. } => values.len(),
        }
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Values that points have.
    pub fn attributes(&self) -> Attributes {
        self.attributes
    }

    /// Position of a point, metres; NaN if there is no such point.
    #[inline]
    pub fn position(&self, index: usize) -> [f64; 3] {
        let position = match &self.positions {
            Positions::Double(positions) => positions.get(index).copied(),
            Positions::Single { offset: [a, b, c], values } => {
                let value = values.get(index).map(|value| value.map(f64::from));
                value.map(|[x, y, z]| [a + x, b + y, c + z])
            }
        };
        position.unwrap_or([f64::NAN; 3])
    }

    /// All positions.
    pub fn positions(&self) -> &Positions {
        &self.positions
    }

    /// Intensity of a point, in the unit of its file; none if the cloud has no intensities.
    pub fn intensity(&self, index: usize) -> Option<f32> {
        self.intensities.get(index).copied()
    }

    /// Time of a point, seconds; none if the cloud has no times.
    pub fn time(&self, index: usize) -> Option<f64> {
        self.times.get(index).copied()
    }

    /// Red, green and blue of a point; none if the cloud has no colours.
    pub fn color(&self, index: usize) -> Option<[u8; 3]> {
        self.colors.get(index).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn single_precision_keeps_far_places() {
        let attributes = Attributes { time: true, ..Attributes::default() };
        let mut cloud = PointCloud::single([5e6, 4e5, 300.0], attributes);
        cloud.push([5e6 + 12.345_67, 4e5 - 3.0, 301.0], 1.0, 2.5, [1, 2, 3]);
        assert!((cloud.position(0)[0] - 5e6 - 12.345_67).abs() < 1e-6);
        assert_eq!((cloud.time(0), cloud.intensity(0), cloud.color(0)), (Some(2.5), None, None));
        let mut double = PointCloud::new(Attributes { color: true, ..attributes });
        double.extend(&cloud);
        assert_eq!((double.len(), double.color(0), double.position(0)), (1, Some([0; 3]), cloud.position(0)));
        double.reset(Attributes::default());
        assert!(double.is_empty());
    }
}
