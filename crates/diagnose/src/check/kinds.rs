//! Kinds of findings that [`super::check`] reports itself, with their effects and remedies.

use portolan_issue::Severity;

use crate::finding::Kind;

pub(super) const MAP_PARENT: Kind = Kind {
    name: "map parent",
    severity: Severity::Warning,
    effect: "these transforms are not used",
    to_do: "nothing; record without them to keep the recording small",
};

pub(super) const TRANSFORMS: Kind = Kind {
    name: "transforms",
    severity: Severity::Warning,
    effect: "the transform is not used",
    to_do: "look for two programs that publish the same frame",
};

pub(super) const NO_PLAN: Kind = Kind {
    name: "no plan",
    severity: Severity::Error,
    effect: "there is nothing to make a map of",
    to_do: "see what is missing above; a robot description is given with --urdf, topics with --scan, --points",
};

pub(super) const DAMAGE: Kind = Kind {
    name: "damage",
    severity: Severity::Error,
    effect: "what could not be read is missing in the map",
    to_do: "take an undamaged copy if there is one; the rest can be mapped",
};

pub(super) const CLOCK_SET: Kind = Kind {
    name: "clock set",
    severity: Severity::Warning,
    effect: "measurements before and after the jump are joined as if the robot had stood still in between",
    to_do: "wait until the clock is set before recording; map one part alone with --skip or --duration",
};

pub(super) const ODOMETRY_ELSEWHERE: Kind = Kind {
    name: "odometry elsewhere",
    severity: Severity::Error,
    effect: "motion between scans is predicted wrongly: map leaves this odometry out",
    to_do: "check its units (metres, radians), the transform from its frame to the scanner, and whether it is of this robot",
};

pub(super) const SCAN_DURATION: Kind = Kind {
    name: "scan duration",
    severity: Severity::Warning,
    effect: "scans are bent where the robot turns; map de-skews them with the measured duration",
    to_do: "let the driver fill in time_increment, the seconds from one beam to the next",
};

pub(super) const NOISY: Kind = Kind {
    name: "noisy ranges",
    severity: Severity::Warning,
    effect: "walls are thicker than a cell; map smooths the readings along walls, and small things are lost",
    to_do: "see whether the scanner has a mode with less noise; far readings of small scanners may be left out",
};

pub(super) const JITTER: Kind = Kind {
    name: "stamp jitter",
    severity: Severity::Warning,
    effect: "the motion between scans is predicted and de-skewed for wrong times; map uses times from the usual rate",
    to_do: "let the driver stamp the time of measurement, not that of arrival",
};

pub(super) const HELD_BACK: Kind = Kind {
    name: "odometry held back",
    severity: Severity::Warning,
    effect: "odometry stands while the robot moves, and then jumps; map leaves out poses that repeat",
    to_do: "publish only new poses, stamped with their time of measurement",
};

pub(super) const ASSUMED: Kind = Kind {
    name: "assumed",
    severity: Severity::Warning,
    effect: "the result may be worse than it could be; map does the same",
    to_do: "",
};

pub(super) const REPAIRED: Kind = Kind {
    name: "repaired",
    severity: Severity::Info,
    effect: "nothing is lost; mapping repairs it in the same way",
    to_do: "",
};
