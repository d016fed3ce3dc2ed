//! Cuts maps by area.

use portolan_geometry::Rigid3;

use super::clear::ClearedArea;
use super::{EditError, MapDraft};
use crate::paint::MapArea;
use portolan_pbstream::submap_poses;

impl MapDraft {
    /// Keeps only nodes inside a rectangle of the global map or, with `inside` false, only those outside of
    /// it. Submaps are kept or removed as a whole, by the rule of [`MapDraft::cut_time`]. With `inside` false
    /// the cells of the kept submaps in the rectangle are cleared.
    ///
    /// # Errors
    /// If nothing would be left.
    pub fn cut_area(&mut self, area: &MapArea, inside: bool) -> Result<(), EditError> {
        let wanted = |pose: &Rigid3| {
            let (x, y) = (pose.translation.x, pose.translation.y);
            let within = (area.min_x..=area.max_x).contains(&x) && (area.min_y..=area.max_y).contains(&y);
            within == inside
        };
        self.retain_nodes(&|_, pose, _| wanted(pose), &wanted)?;
        if !inside {
            self.cleared.push(ClearedArea { area: *area, submaps: submap_poses(&self.graph) });
        }
        Ok(())
    }
}
