//! Caches the matchers of submaps, which are expensive to build, for the next search.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use portolan_config::ConstraintBuilderOptions;

use crate::{Space, SubmapId};

/// The most recently used matchers. The contents affect only the time of a search, not its result.
pub(super) struct MatcherCache<S: Space> {
    kept: Mutex<KeptMatchers<S>>,
}

struct KeptMatchers<S: Space> {
    uses: u64,
    by_submap: BTreeMap<SubmapId, (u64, Arc<S::Matcher>)>,
}

impl<S: Space> Default for MatcherCache<S> {
    fn default() -> Self {
        Self { kept: Mutex::new(KeptMatchers { uses: 0, by_submap: BTreeMap::new() }) }
    }
}

impl<S: Space> MatcherCache<S> {
    fn lock(&self) -> MutexGuard<'_, KeptMatchers<S>> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The matcher of a submap, built if there is none.
    pub fn get_or_build(
        &self,
        id: SubmapId,
        submap: &S::Submap,
        options: &ConstraintBuilderOptions,
    ) -> Option<Arc<S::Matcher>> {
        let kept = self.lock().by_submap.get(&id).map(|(_, matcher)| Arc::clone(matcher));
        let matcher = match kept {
            Some(matcher) => matcher,
            None => Arc::new(S::build_matcher(submap, options)?),
        };
        let mut kept = self.lock();
        kept.uses += 1;
        let used = kept.uses;
        kept.by_submap.insert(id, (used, Arc::clone(&matcher)));
        kept.shrink();
        Some(matcher)
    }

    /// Drops what exceeds the memory that matchers may take.
    pub fn shrink(&self) {
        self.lock().shrink();
    }

    /// Forgets the matcher of a submap.
    pub fn remove(&self, id: &SubmapId) {
        self.lock().by_submap.remove(id);
    }
}

impl<S: Space> KeptMatchers<S> {
    /// Drops those that were not used for longest until the rest fits.
    fn shrink(&mut self) {
        let mut total: usize = self.by_submap.values().map(|(_, m)| S::matcher_bytes(m)).sum();
        while total > S::MATCHER_CACHE_BYTES {
            let oldest = self.by_submap.iter().min_by_key(|(_, (used, _))| *used).map(|(id, _)| *id);
            let Some((_, matcher)) = oldest.and_then(|id| self.by_submap.remove(&id)) else { break };
            total -= S::matcher_bytes(&matcher);
        }
    }
}
