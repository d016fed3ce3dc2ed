#![doc = include_str!("../README.md")]

mod belief;
mod change_regions;
mod changes;
mod distinctness;
mod evidence;
mod finder;
mod hypothesis;
mod information;
mod jumps;
mod known_cells;
mod known_map;
mod likelihood;
mod localizer;
mod occupancy;
mod placed_scan;
mod planar_map;
mod planar_scan;
mod recent;
mod rivals;
mod scan_match;
mod search;
mod spatial_map;
mod spatial_scan;
mod state;

pub use belief::{Freedom, Matrix6};
pub use changes::{Change, ChangeKind};
pub use distinctness::{Distinctness, ExaminedPlace, OtherPlace, PlaceExaminer};
pub use jumps::{Corrections, Jumps};
pub use known_map::{KnownMap, KnownMapError, ScanMatch, Window};
pub use localizer::{Localizer, LocalizerError, LocalizerSettings, StartPose};
pub use planar_map::PlanarMap;
pub use recent::RecentScans;
pub use spatial_map::SpatialMap;
pub use state::{Estimate, Place, Reason, State};
