//! Reads from a text which scans are matched with each other.

use crate::Link;

/// A line of links that cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {reason}")]
pub struct BadLinkLine {
    /// Line number, from 1.
    line: usize,
    reason: String,
}

/// Parses the links in a text: number of scans, number of links, then two scans a line, counted from 0. There
/// are `count` scans.
///
/// # Errors
/// Fails on a line that does not name two of the scans.
pub fn links_of_text(text: &str, count: usize) -> Result<Vec<Link>, BadLinkLine> {
    let bad = |line: usize, reason: String| BadLinkLine { line: line + 1, reason };
    let mut links = Vec::new();
    for (number, line) in text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty()) {
        let values: Option<Vec<usize>> = line.split_ascii_whitespace().map(|w| w.parse().ok()).collect();
        match values.as_deref() {
            // The two counts are not needed.
            Some([_]) if links.is_empty() => {}
            Some([from, to, ..]) if from != to && *from < count && *to < count => {
                let link = Link { from: *from.min(to), to: *from.max(to) };
                if !links.contains(&link) {
                    links.push(link);
                }
            }
            Some([_, _, ..]) => {
                let last = count.saturating_sub(1);
                return Err(bad(number, format!("a link joins two of the scans 0 to {last}")));
            }
            _ => return Err(bad(number, "expected the numbers of two scans".to_owned())),
        }
    }
    Ok(links)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn links_are_read_and_bad_ones_named() {
        let links = links_of_text("4\n3\n0 1\n2 1\n1 2\n", 4).unwrap();
        assert_eq!(links, [Link { from: 0, to: 1 }, Link { from: 1, to: 2 }]);
        for bad in ["4\n1\n0 4\n", "4\n1\n1 1\n", "0 x\n", "0 1\n5\n"] {
            let error = links_of_text(bad, 4).unwrap_err().to_string();
            assert!(error.starts_with("line "), "{error}");
        }
    }
}
