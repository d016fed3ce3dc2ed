//! The tree as text, for reports.

use portolan_geometry::{Rigid3, roll_pitch_yaw};

use super::{Edge, Motion, TfTree};

/// Deeper levels are left out of the text.
const MAX_DEPTH: usize = 60;

impl TfTree {
    /// One line per frame, children below their parents, in ascending order.
    pub fn to_text(&self) -> String {
        let mut text = String::new();
        for index in self.index.values().filter(|i| self.edge(**i).is_none()) {
            text.push_str(self.name(*index));
            text.push('\n');
            self.write_children(*index, "", 0, &mut text);
        }
        text
    }

    fn write_children(&self, parent: usize, indent: &str, depth: usize, text: &mut String) {
        let is_child = |i: &&usize| self.edge(**i).is_some_and(|edge| edge.parent == parent);
        let children: Vec<usize> = self.index.values().filter(is_child).copied().collect();
        if depth == MAX_DEPTH && !children.is_empty() {
            text.push_str(indent);
            text.push_str("└─ …\n");
            return;
        }
        for (i, child) in children.iter().enumerate() {
            let last = i + 1 == children.len();
            text.push_str(indent);
            text.push_str(if last { "└─ " } else { "├─ " });
            text.push_str(self.name(*child));
            if let Some(edge) = self.edge(*child) {
                text.push_str(&describe(edge));
            }
            text.push('\n');
            let deeper = format!("{indent}{}", if last { "   " } else { "│  " });
            self.write_children(*child, &deeper, depth + 1, text);
        }
    }
}

fn describe(edge: &Edge) -> String {
    match &edge.motion {
        Motion::Moving(_) => " (moves)".to_owned(),
        Motion::Static(pose) if *pose == Rigid3::identity() => " (same place)".to_owned(),
        Motion::Static(pose) => {
            let t = pose.translation.vector;
            let (roll, pitch, yaw) = roll_pitch_yaw(&pose.rotation);
            let place = format!("{} {} {} m", short(t.x), short(t.y), short(t.z));
            if pose.rotation.angle() < 1e-6 {
                return format!(" ({place})");
            }
            let degrees = [roll, pitch, yaw].map(|a| short(a.to_degrees()));
            format!(" ({place}, {}°)", degrees.join(" "))
        }
    }
}

/// At most four decimals, without trailing zeros.
fn short(value: f64) -> String {
    let text = format!("{value:.4}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}
