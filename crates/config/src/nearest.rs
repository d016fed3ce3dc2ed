//! Suggests the known name for a misspelt one.

/// The candidate with the smallest edit distance, if that is small enough; of equal ones the first.
pub(crate) fn nearest<'a>(name: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let limit = (name.chars().count() / 3).max(2);
    candidates
        .into_iter()
        .map(|candidate| (edit_distance(name, candidate, limit), candidate))
        .filter(|(distance, _)| *distance <= limit)
        .min_by_key(|(distance, _)| *distance)
        .map(|(_, candidate)| candidate)
}

/// Edit distance of two names: the number of insertions, deletions, substitutions and swaps of neighbours
/// that turn one into the other. If the lengths alone exceed `limit`, any number above it.
pub fn edit_distance(a: &str, b: &str, limit: usize) -> usize {
    let (a, b): (Vec<char>, Vec<char>) = (a.chars().collect(), b.chars().collect());
    if a.len().abs_diff(b.len()) > limit {
        return limit + 1;
    }
    let mut before_last: Vec<usize> = Vec::new();
    let mut last: Vec<usize> = (0..=b.len()).collect();
    for i in 1..=a.len() {
        let mut row = vec![i];
        for j in 1..=b.len() {
            let substitution = last[j - 1] + usize::from(a[i - 1] != b[j - 1]);
            let mut best = substitution.min(last[j] + 1).min(row[j - 1] + 1);
            if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                best = best.min(before_last[j - 2] + 1);
            }
            row.push(best);
        }
        before_last = std::mem::replace(&mut last, row);
    }
    last.last().copied().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_count_edits_and_swaps() {
        for (a, b, distance) in
            [("", "", 0), ("abc", "abc", 0), ("abc", "acb", 1), ("min_scor", "min_score", 1)]
        {
            assert_eq!(edit_distance(a, b, 5), distance, "{a} {b}");
            assert_eq!(edit_distance(b, a, 5), distance, "{b} {a}");
        }
    }

    #[test]
    fn the_nearest_name_is_found_and_far_ones_are_not_offered() {
        let names = ["min_score", "sampling_ratio", "max_range"];
        assert_eq!(nearest("max_rnage", names), Some("max_range"));
        assert_eq!(nearest("samplingratio", names), Some("sampling_ratio"));
        assert_eq!(nearest("voxel", names), None);
    }
}
