//! Summary of a registration for the user.

use std::path::PathBuf;

use portolan::job::register::{Registered, Registration};
use portolan_geometry::{Quaternion, nalgebra as na};

use crate::output::counted;

/// Advice if the result is unreliable.
pub const ADVICE: &str = "give a more accurate first pose (--guess, --poses), a larger --max-distance or more --iterations, if the \
    scans overlap at all; --force writes the result all the same";

/// Summary of a registration: poses, loops, global matching and files.
pub fn text(work: &Registration, registered: &[Registered], files: &[PathBuf]) -> String {
    let mut text = String::new();
    for scan in registered {
        let [x, y, z, qx, qy, qz, qw] = scan.pose;
        let rotation = Quaternion::new_normalize(na::Quaternion::new(qw, qx, qy, qz));
        let (roll, pitch, yaw) = rotation.euler_angles();
        text += &format!(
            "{}: x {x:.4} y {y:.4} z {z:.4} m, roll {:.3} pitch {:.3} yaw {:.3} deg",
            scan.file,
            roll.to_degrees(),
            pitch.to_degrees(),
            yaw.to_degrees()
        );
        if scan.iterations > 0 {
            text += &format!(
                "; {} within {:.4} m rms, {}{}",
                counted(scan.pairs, "pair", "pairs"),
                scan.rms,
                counted(scan.iterations as u64, "iteration", "iterations"),
                if scan.converged { "" } else { ", not converged" }
            );
        }
        if let Some(d) = scan.deviations {
            let [shift, turn] = [&d[3..], &d[..3]].map(|part| part.iter().map(|v| v * v).sum::<f64>().sqrt());
            text += &format!(", sigma {:.2} mm and {:.4} deg", 1e3 * shift, turn.to_degrees());
        }
        if scan.distrust.is_some() {
            text += ", NOT to be trusted";
        }
        if let Some(error) = &scan.error {
            text += &format!("; not matched: {error}");
        }
        text += "\n";
    }
    for closed in &work.sequence.loops {
        text += &format!(
            "loop closed from scan {} to scan {}: {:.3} m and {:.3} deg distributed\n",
            closed.first,
            closed.last,
            closed.translation,
            closed.rotation.to_degrees()
        );
    }
    if let Some(global) = &work.global {
        text += &format!(
            "global matching: {}, {} within {:.4} m rms, {}{}\n",
            counted(global.links as u64, "link", "links"),
            counted(global.pairs, "pair", "pairs"),
            global.rms,
            counted(global.iterations as u64, "iteration", "iterations"),
            if global.converged { "" } else { ", not converged" }
        );
    }
    for file in files {
        text += &format!("{}\n", file.display());
    }
    text
}
