//! The tunable numbers of localisation, by theme. Each comment gives the unit and the reason for the value,
//! and names the experiment where there is one; a value without a reason is assumed. Units are metres,
//! radians and seconds unless stated otherwise.
//!
//! Sizes of arrays, limits of number formats and terms that keep matrices regular are no settings: they are
//! defined where they are used.

pub(crate) mod changes;
pub(crate) mod evidence;
pub(crate) mod jumps;
pub(crate) mod maps;
pub(crate) mod matching;
pub(crate) mod scans;
pub(crate) mod search;
pub(crate) mod tracking;
