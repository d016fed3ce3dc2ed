//! Fill-in: the non-zero blocks of the factor of a sparse symmetric matrix.

/// For each column of the factor the non-zero rows below the diagonal, ascending; `lower` gives those of the
/// matrix. Eliminating a column couples all its rows with each other, so a column also has the rows of every
/// column whose first row it is (its children in the elimination tree).
pub(super) fn factor_rows<'a>(n: usize, lower: impl Fn(usize) -> &'a [u32]) -> Vec<Vec<u32>> {
    let mut rows: Vec<Vec<u32>> = Vec::with_capacity(n);
    let mut children: Vec<Vec<u32>> = vec![Vec::new(); n];
    let mut seen = vec![u32::MAX; n];
    for column in 0..n {
        let mut own: Vec<u32> = Vec::new();
        let mut take = |list: &[u32]| {
            for row in list.iter().filter(|row| **row as usize > column) {
                if seen[*row as usize] != column as u32 {
                    seen[*row as usize] = column as u32;
                    own.push(*row);
                }
            }
        };
        take(lower(column));
        for child in std::mem::take(&mut children[column]) {
            take(&rows[child as usize]);
        }
        own.sort_unstable();
        if let Some(parent) = own.first() {
            children[*parent as usize].push(column as u32);
        }
        rows.push(own);
    }
    rows
}

/// Postorder of the elimination tree, `order[new] = old`: each column comes directly after the columns whose
/// first row it is, and of these the one with most rows comes last. The factor stays as sparse as before.
pub(super) fn postorder(rows: &[Vec<u32>]) -> Vec<u32> {
    let n = rows.len();
    let mut children: Vec<Vec<u32>> = vec![Vec::new(); n];
    let mut waiting = Vec::new();
    for (column, own) in rows.iter().enumerate().rev() {
        match own.first() {
            Some(parent) => children[*parent as usize].push(column as u32),
            None => waiting.push(column as u32),
        }
    }
    let mut reversed = Vec::with_capacity(n);
    // In reverse: a column, then everything below its last child, then everything below the others.
    while let Some(column) = waiting.pop() {
        reversed.push(column);
        let mut of_column = std::mem::take(&mut children[column as usize]);
        of_column.sort_by_key(|child| rows[*child as usize].len());
        waiting.extend(of_column);
    }
    reversed.reverse();
    reversed
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn elimination_couples_the_neighbours_of_a_column() {
        let lower: [&[u32]; 5] = [&[2, 4], &[3], &[], &[4], &[]];
        let rows = factor_rows(5, |column| lower[column]);
        assert_eq!(rows, [vec![2, 4], vec![3], vec![4], vec![4], vec![]]);
        let order = postorder(&rows);
        assert_eq!(order.last(), Some(&4));
        let position = |column: u32| order.iter().position(|c| *c == column).unwrap();
        assert_eq!((position(2) - position(0), position(3) - position(1)), (1, 1));
    }
}
