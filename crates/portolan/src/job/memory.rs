//! Reports the memory use of the program, where the system provides it.

/// Memory in use and its peak, bytes; `None` on systems without this information.
pub fn resident_and_peak_bytes() -> Option<(u64, u64)> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let field = |name: &str| {
        let line = status.lines().find_map(|line| line.strip_prefix(name))?;
        line.split_whitespace().next()?.parse::<u64>().ok().map(|kibibytes| kibibytes * 1024)
    };
    Some((field("VmRSS:")?, field("VmHWM:")?))
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    #[test]
    fn peak_memory_is_at_least_the_current_use() {
        let (resident, peak) = super::resident_and_peak_bytes().unwrap();
        assert!(resident > 1 << 20 && peak >= resident);
    }
}
