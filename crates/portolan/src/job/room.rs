//! Estimates the disk space for the results, before mapping begins.

/// Minimum size of trajectory, report and pictures, bytes.
const LEAST: u64 = 1 << 20;
/// Bytes of the recording for which a map takes at least one byte. Real maps take several times as much.
const RECORDING_BY_MAP: u64 = 400;
/// Bytes of the recording for which a cloud of its points takes at least one byte.
const RECORDING_BY_CLOUD: u64 = 50;

/// Minimum size of the results, bytes.
pub(super) fn needed(recording_bytes: u64, with_cloud: bool) -> u64 {
    let cloud = if with_cloud { recording_bytes / RECORDING_BY_CLOUD } else { 0 };
    LEAST + recording_bytes / RECORDING_BY_MAP + cloud
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clouds_need_more_disk_space() {
        assert!(needed(1 << 30, true) > needed(1 << 30, false) && needed(0, true) == LEAST);
    }
}
