//! Stores short lists of values, packed one after the other.

/// Sizes of lists that are handed out.
const CAPACITIES: [u8; 10] = [2, 4, 6, 8, 12, 16, 24, 32, 48, 64];
/// For each number of values the smallest size that holds them.
const CLASS_OF_COUNT: [u8; 65] = {
    let mut classes = [0; 65];
    let (mut count, mut class) = (0, 0);
    while count <= 64 {
        if count > CAPACITIES[class] as usize {
            class += 1;
        }
        classes[count] = class as u8;
        count += 1;
    }
    classes
};

/// Lists of up to 64 values. A list is known by the place of its first value and by its length, which the
/// owner keeps. Room that a list leaves behind when it grows is given to the next one of that size.
#[derive(Clone, Debug)]
pub(super) struct Arena<T> {
    values: Vec<T>,
    free: [Vec<u32>; CAPACITIES.len()],
}

/// Appends with room for an eighth more, not for twice as much: grids are long-lived.
pub(super) fn push_tight<T>(list: &mut Vec<T>, value: T) {
    reserve_tight(list, 1);
    list.push(value);
}

fn reserve_tight<T>(list: &mut Vec<T>, additional: usize) {
    if list.capacity() - list.len() < additional {
        list.reserve_exact(additional.max(list.len() / 8));
    }
}

impl<T: Copy + Default> Arena<T> {
    pub fn with_capacity(num_values: usize) -> Self {
        Self { values: Vec::with_capacity(num_values), free: Default::default() }
    }

    /// Capacity of a list of `count` values.
    pub fn capacity_for(count: usize) -> usize {
        usize::from(CAPACITIES[usize::from(CLASS_OF_COUNT[count])])
    }

    /// Room for a list of `count` values, or none when four thousand million of them are there already.
    pub fn allocate(&mut self, count: usize) -> Option<u32> {
        let class = usize::from(CLASS_OF_COUNT[count]);
        if let Some(start) = self.free[class].pop() {
            return Some(start);
        }
        let start = u32::try_from(self.values.len()).ok()?;
        let capacity = usize::from(CAPACITIES[class]);
        reserve_tight(&mut self.values, capacity);
        self.values.resize(self.values.len() + capacity, T::default());
        Some(start)
    }

    /// Puts `value` at position `rank` of a list of `count` values. Returns the start of the list afterwards.
    pub fn insert(&mut self, start: u32, count: usize, rank: usize, value: T) -> Option<u32> {
        let (old_class, new_class) = (CLASS_OF_COUNT[count], CLASS_OF_COUNT[count + 1]);
        let mut place = start;
        if old_class != new_class {
            place = self.allocate(count + 1)?;
            let from = start as usize;
            self.values.copy_within(from..from + count, place as usize);
            push_tight(&mut self.free[usize::from(old_class)], start);
        }
        let list = &mut self.values[place as usize..][..=count];
        list.copy_within(rank..count, rank + 1);
        list[rank] = value;
        Some(place)
    }

    /// Room for as many values as the second of two counts, for a list with the first. Where the list starts
    /// afterwards; its values are lost if it moves.
    pub fn resize(&mut self, start: u32, [before, after]: [usize; 2]) -> Option<u32> {
        let [old_class, new_class] = [before, after].map(|count| CLASS_OF_COUNT[count]);
        if old_class == new_class {
            return Some(start);
        }
        let place = self.allocate(after)?;
        push_tight(&mut self.free[usize::from(old_class)], start);
        Some(place)
    }

    #[inline]
    pub fn at(&self, index: usize) -> T {
        self.values[index]
    }

    #[inline]
    pub fn at_mut(&mut self, index: usize) -> &mut T {
        &mut self.values[index]
    }

    #[inline]
    pub fn list(&self, start: u32, count: usize) -> &[T] {
        &self.values[start as usize..][..count]
    }

    #[inline]
    pub fn list_mut(&mut self, start: u32, count: usize) -> &mut [T] {
        &mut self.values[start as usize..][..count]
    }

    pub fn memory_bytes(&self) -> usize {
        let free: usize = self.free.iter().map(Vec::capacity).sum();
        self.values.capacity() * size_of::<T>() + free * size_of::<u32>()
    }
}
