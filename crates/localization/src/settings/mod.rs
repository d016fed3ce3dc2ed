//! The numbers of localisation that could be others, by theme. Each says its unit and why it is what it is, and names the experiment
//! where there is one; where no reason is named it is assumed. Metres, radians and seconds if nothing else is said.
//!
//! Sizes of arrays, bounds of number formats and what keeps matrices regular are no settings: they stand where they are used.

pub(crate) mod changes;
pub(crate) mod evidence;
pub(crate) mod jumps;
pub(crate) mod maps;
pub(crate) mod matching;
pub(crate) mod scans;
pub(crate) mod search;
pub(crate) mod tracking;
