//! Approximate minimum degree ordering: an order of elimination that keeps the factor of a sparse symmetric
//! matrix sparse.
//!
//! Amestoy, Davis, Duff: An approximate minimum degree ordering algorithm, SIAM J. Matrix Anal. Appl. 17
//! (1996). The graph during elimination is stored as a quotient graph: an eliminated variable becomes an
//! *element*, which represents all pairs of its neighbours. Degrees are bounded from above by the sizes of
//! elements (their equation 4). Variables with the same neighbours are merged, and elements contained in
//! another one are absorbed.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Variables with more neighbours than this multiple of the square root of the number of variables are
/// eliminated last: they become coupled with nearly everything anyway, and scanning them for each pivot is
/// slow.
const DENSE: f64 = 10.0;
/// Minimum number of neighbours of a dense variable.
const FEW: usize = 16;

/// An order of elimination, `order[new] = old`, of variables with these neighbours. Each list is ascending
/// and does not contain its owner.
pub(super) fn minimum_degree(neighbours: Vec<Vec<u32>>) -> Vec<u32> {
    let n = neighbours.len();
    let many = FEW.max((DENSE * (n as f64).sqrt()) as usize);
    let mut dense: Vec<u32> = (0..n as u32).filter(|i| neighbours[*i as usize].len() > many).collect();
    dense.sort_by_key(|i| neighbours[*i as usize].len());
    let mut graph = QuotientGraph::new(neighbours, &dense);
    let mut order = graph.eliminate();
    order.extend(dense);
    order
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// Not eliminated yet.
    Variable,
    /// Eliminated; its members are coupled with each other.
    Element,
    /// Merged into another variable, absorbed by another element, or left out.
    Removed,
}

struct QuotientGraph {
    kind: Vec<Kind>,
    /// Neighbours of a variable that are not represented by an element.
    variables: Vec<Vec<u32>>,
    /// Elements of which a variable is a member, in the order of their creation.
    elements: Vec<Vec<u32>>,
    /// Variables of an element.
    members: Vec<Vec<u32>>,
    /// Number of original variables that a variable represents, or the total over the members of an element.
    weight: Vec<u32>,
    degree: Vec<u32>,
    /// Variables that are eliminated together with a variable, directly after it.
    followers: Vec<Vec<u32>>,
    queue: BinaryHeap<Reverse<(u32, u32)>>,
    /// The last pivot that had this variable as a neighbour.
    seen_by: Vec<u32>,
    /// The last pivot for which `outside` of this element was computed.
    counted_for: Vec<u32>,
    /// Weight of the members of an element that are not neighbours of the pivot.
    outside: Vec<u32>,
    remaining: u32,
}

const NEVER: u32 = u32::MAX;

impl QuotientGraph {
    fn new(mut variables: Vec<Vec<u32>>, without: &[u32]) -> Self {
        let n = variables.len();
        let mut kind = vec![Kind::Variable; n];
        without.iter().for_each(|i| kind[*i as usize] = Kind::Removed);
        if !without.is_empty() {
            variables.iter_mut().for_each(|list| list.retain(|i| kind[*i as usize] == Kind::Variable));
        }
        let degree: Vec<u32> = variables.iter().map(|list| list.len() as u32).collect();
        let of_all = (0..n as u32).filter(|i| kind[*i as usize] == Kind::Variable);
        let queue = of_all.map(|i| Reverse((degree[i as usize], i))).collect();
        Self {
            kind,
            variables,
            elements: vec![Vec::new(); n],
            members: vec![Vec::new(); n],
            weight: vec![1; n],
            degree,
            followers: vec![Vec::new(); n],
            queue,
            seen_by: vec![NEVER; n],
            counted_for: vec![NEVER; n],
            outside: vec![0; n],
            remaining: (n - without.len()) as u32,
        }
    }

    fn is_variable(&self, i: u32) -> bool {
        self.kind[i as usize] == Kind::Variable
    }

    fn eliminate(&mut self) -> Vec<u32> {
        let mut order = Vec::with_capacity(self.kind.len());
        while let Some(Reverse((degree, pivot))) = self.queue.pop() {
            if !self.is_variable(pivot) || self.degree[pivot as usize] != degree {
                continue;
            }
            self.remaining -= self.weight[pivot as usize];
            let neighbours = self.make_element(pivot);
            self.count_outside(&neighbours, pivot);
            let coupled = self.weight[pivot as usize];
            let mut hashes: Vec<(u64, u32)> = Vec::with_capacity(neighbours.len());
            for i in &neighbours {
                hashes.extend(self.update(*i, pivot, coupled).map(|hash| (hash, *i)));
            }
            self.merge_alike(&mut hashes);
            self.close(pivot, neighbours);
            self.append(&mut order, pivot);
        }
        order
    }

    /// Turns the pivot into an element and returns its neighbours.
    fn make_element(&mut self, pivot: u32) -> Vec<u32> {
        self.kind[pivot as usize] = Kind::Element;
        self.seen_by[pivot as usize] = pivot;
        let mut neighbours = Vec::new();
        let mut weight = 0;
        let own = std::mem::take(&mut self.variables[pivot as usize]);
        let elements = std::mem::take(&mut self.elements[pivot as usize]);
        let mut take = |graph: &mut Self, list: &[u32]| {
            for i in list {
                if graph.is_variable(*i) && graph.seen_by[*i as usize] != pivot {
                    graph.seen_by[*i as usize] = pivot;
                    weight += graph.weight[*i as usize];
                    neighbours.push(*i);
                }
            }
        };
        take(self, &own);
        for element in elements {
            if self.kind[element as usize] == Kind::Element {
                self.kind[element as usize] = Kind::Removed;
                let members = std::mem::take(&mut self.members[element as usize]);
                take(self, &members);
            }
        }
        self.weight[pivot as usize] = weight;
        neighbours.sort_unstable();
        neighbours
    }

    /// Computes for each element of these variables the weight of its members outside them.
    fn count_outside(&mut self, neighbours: &[u32], pivot: u32) {
        for i in neighbours {
            for element in &self.elements[*i as usize] {
                let e = *element as usize;
                if self.counted_for[e] != pivot {
                    self.counted_for[e] = pivot;
                    self.outside[e] = self.weight[e];
                }
                self.outside[e] -= self.weight[*i as usize].min(self.outside[e]);
            }
        }
    }

    /// Updates the couplings and the degree of a neighbour of the pivot and returns a hash of the couplings.
    /// If only the pivot is left, the neighbour is eliminated along with it and the result is `None`.
    fn update(&mut self, i: u32, pivot: u32, coupled: u32) -> Option<u64> {
        let own_weight = self.weight[i as usize];
        let mut degree = coupled - own_weight;
        let mut hash = 0u64;
        let mut elements = std::mem::take(&mut self.elements[i as usize]);
        elements.retain(|element| {
            let e = *element as usize;
            if self.kind[e] == Kind::Element && self.outside[e] == 0 {
                // The pivot couples everything that this element couples: absorb it.
                self.kind[e] = Kind::Removed;
                self.members[e] = Vec::new();
            }
            let is_kept = self.kind[e] == Kind::Element;
            if is_kept {
                degree += self.outside[e];
                hash = hash.wrapping_add(u64::from(*element));
            }
            is_kept
        });
        let mut variables = std::mem::take(&mut self.variables[i as usize]);
        variables.retain(|other| {
            let is_kept = self.is_variable(*other) && self.seen_by[*other as usize] != pivot;
            if is_kept {
                degree += self.weight[*other as usize];
                hash = hash.wrapping_add(u64::from(*other) << 20);
            }
            is_kept
        });
        if elements.is_empty() && variables.is_empty() {
            self.kind[i as usize] = Kind::Removed;
            self.remaining -= own_weight;
            self.weight[pivot as usize] -= own_weight;
            self.followers[pivot as usize].push(i);
            return None;
        }
        elements.push(pivot);
        self.elements[i as usize] = elements;
        self.variables[i as usize] = variables;
        let most = (self.remaining - own_weight.min(self.remaining))
            .min(self.degree[i as usize].saturating_add(coupled - own_weight));
        self.degree[i as usize] = degree.min(most);
        Some(hash)
    }

    /// Merges variables that have the same couplings.
    fn merge_alike(&mut self, hashes: &mut [(u64, u32)]) {
        hashes.sort_unstable();
        for alike in hashes.chunk_by(|a, b| a.0 == b.0) {
            for (index, (_, first)) in alike.iter().enumerate() {
                if !self.is_variable(*first) {
                    continue;
                }
                for (_, other) in &alike[index + 1..] {
                    let (a, b) = (*first as usize, *other as usize);
                    if self.is_variable(*other)
                        && self.elements[a] == self.elements[b]
                        && self.variables[a] == self.variables[b]
                    {
                        self.kind[b] = Kind::Removed;
                        self.degree[a] -= self.weight[b].min(self.degree[a]);
                        self.weight[a] += self.weight[b];
                        self.elements[b] = Vec::new();
                        self.variables[b] = Vec::new();
                        self.followers[a].push(*other);
                    }
                }
            }
        }
    }

    /// Stores the remaining members of the element and queues them with their new degrees.
    fn close(&mut self, pivot: u32, neighbours: Vec<u32>) {
        let mut members = neighbours;
        members.retain(|i| self.is_variable(*i));
        self.queue.extend(members.iter().map(|i| Reverse((self.degree[*i as usize], *i))));
        self.members[pivot as usize] = members;
    }

    /// Appends a pivot with everything that is eliminated along with it.
    fn append(&mut self, order: &mut Vec<u32>, pivot: u32) {
        let mut waiting = vec![pivot];
        while let Some(i) = waiting.pop() {
            order.push(i);
            waiting.extend(std::mem::take(&mut self.followers[i as usize]).into_iter().rev());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn neighbours(n: u32, pairs: &[(u32, u32)]) -> Vec<Vec<u32>> {
        let mut lists = vec![Vec::new(); n as usize];
        for (a, b) in pairs {
            lists[*a as usize].push(*b);
            lists[*b as usize].push(*a);
        }
        lists.iter_mut().for_each(|list| list.sort_unstable());
        lists
    }

    fn is_permutation(order: &[u32]) -> bool {
        let mut sorted = order.to_vec();
        sorted.sort_unstable();
        sorted.iter().enumerate().all(|(i, value)| i as u32 == *value)
    }

    #[test]
    fn fully_coupled_variables_are_eliminated_last() {
        // A chain, and one variable that is coupled with all of it.
        let n = 400;
        let chain = (0..n - 2).map(|i| (i, i + 1));
        let pairs: Vec<_> = chain.chain((0..n - 1).map(|i| (i, n - 1))).collect();
        let order = minimum_degree(neighbours(n, &pairs));
        assert!(is_permutation(&order));
        assert_eq!(order.last(), Some(&(n - 1)));
        // The centre of a small star, whose degree falls to that of the others.
        let star: Vec<_> = (1..8).map(|i| (0, i)).collect();
        let order = minimum_degree(neighbours(8, &star));
        assert!(is_permutation(&order));
        assert!(order[6..].contains(&0), "{order:?}");
    }

    #[test]
    fn separate_components_and_single_variables_are_eliminated() {
        let order = minimum_degree(neighbours(7, &[(0, 5), (5, 2), (0, 2), (3, 6)]));
        assert!(is_permutation(&order));
        assert!(minimum_degree(Vec::new()).is_empty());
    }
}
