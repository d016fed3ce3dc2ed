//! `portolan`: options that only Portolan has.
//!
//! Adding one is one entry below: documentation, name, type, default, unit, bounds. It is then read from
//! files, set from the command line, checked, listed and documented; nothing else is to be touched.
//! Files keep these keys in a table `portolan` beside `map_builder`, which may be left out.

use crate::bounds::Bounds;
use crate::define::options;

options! {
    /// What Portolan does beyond the options that Cartographer's files know.
    PortolanOptions {
        /// Predict the motion between scans by integrating odometry over the gap instead of from its last
        /// velocity. Turn it off only to compare with Cartographer.
        use_all_odometry: bool = true, "", Bounds::ANY;
        /// Same input, same result, with any number of threads. Turning it off may gain some time.
        deterministic: bool = true, "", Bounds::ANY;
    }
}
