//! Search for the nearest of many shapes with a tree of bounding boxes.

/// A shape with a surface.
pub(crate) trait Shape {
    /// Least and greatest corner of a box that holds it, metres.
    fn bounds(&self) -> [[f64; 3]; 2];

    /// Distance of a point to its surface, metres.
    fn distance(&self, point: [f64; 3]) -> f64;

    /// The numbers that define the shape; shapes with equal numbers are equal.
    fn numbers(&self) -> [f64; 9];
}

/// Maximum number of shapes in a leaf.
const LEAF: usize = 4;

#[derive(Clone, Copy, Debug)]
struct Node {
    bounds: [[f64; 3]; 2],
    /// Index of the first shape of a leaf, or of the second child; the first child follows its parent.
    first: u32,
    /// Number of shapes of a leaf; 0 for a node with children.
    count: u32,
}

/// Shapes in a tree, so that the nearest one is found without visiting all.
#[derive(Clone, Debug)]
pub(crate) struct ShapeTree<S> {
    shapes: Vec<S>,
    nodes: Vec<Node>,
}

impl<S: Shape> ShapeTree<S> {
    /// Sorts shapes into a tree. Duplicates, which no split could separate, are removed.
    pub fn new(mut shapes: Vec<S>) -> Self {
        let key = |shape: &S| shape.numbers().map(f64::to_bits);
        shapes.sort_by_cached_key(key);
        shapes.dedup_by_key(|shape| key(shape));
        let mut nodes = Vec::new();
        if !shapes.is_empty() {
            build(&mut shapes, 0, &mut nodes);
        }
        Self { shapes, nodes }
    }

    /// Distance to the nearest surface, metres; infinite without shapes.
    pub fn distance(&self, point: [f64; 3]) -> f64 {
        let mut best = f64::INFINITY;
        if !self.nodes.is_empty() && point.iter().all(|v| v.is_finite()) {
            self.visit(0, point, &mut best);
        }
        best
    }

    fn visit(&self, index: usize, point: [f64; 3], best: &mut f64) {
        let node = &self.nodes[index];
        if node.count > 0 {
            let first = node.first as usize;
            for shape in &self.shapes[first..first + node.count as usize] {
                *best = best.min(shape.distance(point));
            }
            return;
        }
        let children = [index + 1, node.first as usize];
        let away = children.map(|child| outside(&self.nodes[child].bounds, point));
        let order = if away[0] <= away[1] { [0, 1] } else { [1, 0] };
        for child in order {
            if away[child] < *best {
                self.visit(children[child], point, best);
            }
        }
    }
}

/// Distance of a point outside a box; zero inside.
fn outside([low, high]: &[[f64; 3]; 2], point: [f64; 3]) -> f64 {
    let squared: f64 = (0..3).map(|k| (low[k] - point[k]).max(point[k] - high[k]).max(0.0).powi(2)).sum();
    squared.sqrt()
}

fn build<S: Shape>(shapes: &mut [S], offset: usize, nodes: &mut Vec<Node>) {
    let bounds = shapes.iter().map(Shape::bounds).fold(
        [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]],
        |[low, high], [l, h]| {
            [std::array::from_fn(|k| low[k].min(l[k])), std::array::from_fn(|k| high[k].max(h[k]))]
        },
    );
    let index = nodes.len();
    nodes.push(Node { bounds, first: offset as u32, count: shapes.len() as u32 });
    if shapes.len() <= LEAF {
        return;
    }
    let middle = |shape: &S, axis: usize| {
        let [low, high] = shape.bounds();
        low[axis] + high[axis]
    };
    let extent = |axis: usize| {
        let (low, high) = shapes.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), shape| {
            (low.min(middle(shape, axis)), high.max(middle(shape, axis)))
        });
        high - low
    };
    let extents = [extent(0), extent(1), extent(2)];
    let axis = (1..3).fold(0, |best, k| if extents[k] > extents[best] { k } else { best });
    shapes.sort_by(|a, b| middle(a, axis).total_cmp(&middle(b, axis)));
    let half = shapes.len() / 2;
    let (left, right) = shapes.split_at_mut(half);
    build(left, offset, nodes);
    let second = nodes.len();
    build(right, offset + half, nodes);
    nodes[index] = Node { bounds, first: second as u32, count: 0 };
}

#[cfg(test)]
mod tests {
    use super::super::SolidBox;
    use super::*;

    #[test]
    fn the_tree_agrees_with_brute_force() {
        let mut random = portolan_numeric::Lcg64::new(3);
        let mut random = || random.uniform();
        let boxes: Vec<SolidBox> = (0..300)
            .map(|_| {
                let low: [f64; 3] = std::array::from_fn(|_| 20.0 * random());
                SolidBox { low, high: low.map(|v| v + 2.0 * random()) }
            })
            .collect();
        let tree = ShapeTree::new(boxes.clone());
        for _ in 0..2000 {
            let point = std::array::from_fn(|_| 24.0 * random() - 2.0);
            let all = boxes.iter().map(|b| b.surface_distance(point)).fold(f64::INFINITY, f64::min);
            assert!((tree.distance(point) - all).abs() < 1e-12);
        }
        let twice = ShapeTree::new([boxes.clone(), boxes].concat());
        assert_eq!((twice.shapes.len(), twice.nodes.len()), (tree.shapes.len(), tree.nodes.len()));
        assert!(ShapeTree::<SolidBox>::new(Vec::new()).distance([0.0; 3]).is_infinite());
        assert!(tree.distance([f64::NAN; 3]).is_infinite());
    }
}
