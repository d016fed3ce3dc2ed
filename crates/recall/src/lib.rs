#![doc = include_str!("../README.md")]

mod answer;
mod fingerprint;

use std::fmt;
use std::sync::Arc;

pub use answer::{Answer, Sink, Words};
pub use fingerprint::Fingerprint;

/// Store of answers, by fingerprint of the question.
pub trait Recall: Send + Sync {
    /// The stored answer to a question; none if there is none.
    fn recall(&self, question: u64) -> Option<Vec<u64>>;

    /// Stores an answer.
    fn keep(&self, question: u64, answer: &[u64]);
}

/// Cache of the results of expensive functions. Without a store, which is the default, everything is computed.
#[derive(Clone, Default)]
pub struct Memory(Option<Arc<dyn Recall>>);

impl Memory {
    /// With this store.
    pub fn new(recall: Arc<dyn Recall>) -> Self {
        Self(Some(recall))
    }

    /// Whether there is a store.
    pub fn is_on(&self) -> bool {
        self.0.is_some()
    }

    /// The answer to a question: the stored one, or else the computed one, which is then stored. `ask` must add to the
    /// fingerprint everything that the answer depends on.
    pub fn answer<T: Answer>(&self, ask: impl FnOnce(&mut Fingerprint), compute: impl FnOnce() -> T) -> T {
        let question = self.question(ask);
        self.recall(question).unwrap_or_else(|| {
            let answer = compute();
            self.keep(question, &answer);
            answer
        })
    }

    /// Fingerprint of a question, to be passed to [`Self::recall`] and [`Self::keep`]; none without a store.
    pub fn question(&self, ask: impl FnOnce(&mut Fingerprint)) -> Option<u64> {
        self.0.as_ref()?;
        let mut question = Fingerprint::default();
        ask(&mut question);
        Some(question.value())
    }

    /// The stored answer to a question; none if there is none or it cannot be read as `T`.
    pub fn recall<T: Answer>(&self, question: Option<u64>) -> Option<T> {
        let words = self.0.as_ref()?.recall(question?)?;
        Words::new(&words).whole()
    }

    /// Stores the answer to a question; does nothing without a store.
    pub fn keep<T: Answer>(&self, question: Option<u64>, answer: &T) {
        if let (Some(recall), Some(question)) = (&self.0, question) {
            let mut words = Vec::new();
            answer.write(&mut words);
            recall.keep(question, &words);
        }
    }
}

impl fmt::Debug for Memory {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Memory").field(&self.is_on()).finish()
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::collections::BTreeMap;
    use std::sync::Mutex;

    use super::*;

    #[derive(Default)]
    struct Notes(Mutex<BTreeMap<u64, Vec<u64>>>);

    impl Recall for Notes {
        fn recall(&self, question: u64) -> Option<Vec<u64>> {
            self.0.lock().unwrap().get(&question).cloned()
        }

        fn keep(&self, question: u64, answer: &[u64]) {
            self.0.lock().unwrap().insert(question, answer.to_vec());
        }
    }

    fn root(memory: &Memory, of: f64, computed: &mut u32) -> f64 {
        memory.answer(
            |question| question.add(of),
            || {
                *computed += 1;
                of.sqrt()
            },
        )
    }

    #[test]
    fn recorded_answers_are_not_computed_again() {
        let memory = Memory::new(Arc::new(Notes::default()));
        let mut computed = 0;
        let roots = [2.0, 3.0, 2.0].map(|of| root(&memory, of, &mut computed));
        assert_eq!((roots, computed), ([2f64.sqrt(), 3f64.sqrt(), 2f64.sqrt()], 2));
    }

    #[test]
    fn without_memory_everything_is_computed() {
        let mut computed = 0;
        for _ in 0..2 {
            root(&Memory::default(), 2.0, &mut computed);
        }
        assert_eq!(computed, 2);
    }

    #[test]
    fn invalid_answers_are_computed_again() {
        let notes = Arc::new(Notes::default());
        let memory = Memory::new(notes.clone());
        let mut computed = 0;
        root(&memory, 2.0, &mut computed);
        for wrong in [vec![], vec![1, 2]] {
            notes.0.lock().unwrap().values_mut().for_each(|answer| answer.clone_from(&wrong));
            assert_eq!(root(&memory, 2.0, &mut computed), 2f64.sqrt());
        }
        assert_eq!(computed, 3);
    }
}
