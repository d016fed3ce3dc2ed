//! Whether there is room for the results, before hours are spent on them.

/// The least that trajectory, report and pictures take, bytes.
const LEAST: u64 = 1 << 20;
/// A map takes at least one byte for so many of the recording, a cloud of its points one for so many. Real ones take
/// several times as much.
const RECORDING_BY_MAP: u64 = 400;
const RECORDING_BY_CLOUD: u64 = 50;

/// What the results will need at the very least, bytes.
pub(super) fn needed(recording_bytes: u64, with_cloud: bool) -> u64 {
    let cloud = if with_cloud { recording_bytes / RECORDING_BY_CLOUD } else { 0 };
    LEAST + recording_bytes / RECORDING_BY_MAP + cloud
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clouds_need_more_room() {
        assert!(needed(1 << 30, true) > needed(1 << 30, false) && needed(0, true) == LEAST);
    }
}
