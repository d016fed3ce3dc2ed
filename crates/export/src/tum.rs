//! Writes trajectories as text with one pose per line: `time x y z qx qy qz qw`.

use std::io::Write;
use std::path::Path;

use portolan_atomic_file::{AtomicFile, WriteError};
use portolan_geometry::{Rigid3, Time};

/// Writes a trajectory. Times are Unix seconds with seven exact decimal places; positions (metres) and
/// quaternions have nine.
///
/// # Errors
/// If the file cannot be written.
pub fn write_tum<'a>(
    path: &Path,
    poses: impl IntoIterator<Item = &'a (Time, Rigid3)>,
) -> Result<(), WriteError> {
    let mut file = AtomicFile::create(path)?;
    for (time, pose) in poses {
        if let Err(source) = writeln!(file, "{}", tum_line(*time, pose)) {
            return Err(file.error(source));
        }
    }
    file.commit()
}

/// One line of such a file, without its line break.
pub fn tum_line(time: Time, pose: &Rigid3) -> String {
    let (t, q) = (&pose.translation, pose.rotation.quaternion());
    format!(
        "{} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9}",
        time.unix_decimal(),
        t.x,
        t.y,
        t.z,
        q.i,
        q.j,
        q.k,
        q.w
    )
}
