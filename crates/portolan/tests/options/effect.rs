//! One line per option: two values, the observed quantity, and the direction of its change.

use portolan::config::{Options, explain};

/// How an observation with the second value compares with that of the first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Expect {
    Rises,
    Falls,
    /// Where no direction is promised.
    Changes,
}

pub use Expect::{Changes, Falls, Rises};

/// The effect of one option.
pub struct Effect {
    /// Path, shortened from the left as far as it fits only one option.
    pub key: &'static str,
    /// Two values.
    pub values: [&'static str; 2],
    /// Direction of the change of the observation from the first to the second value.
    pub expect: Expect,
    /// Other settings, so that the option matters.
    pub given: &'static [&'static str],
    /// What is observed.
    pub observe: fn(&Options) -> f64,
}

impl Effect {
    /// The full path of the option.
    pub fn path(&self) -> String {
        explain(self.key).unwrap_or_else(|| panic!("{} is no single option", self.key)).path
    }

    fn observed(&self, base: &Options, value: &str) -> f64 {
        let mut options = base.clone();
        for setting in self.given {
            options.set(setting).unwrap_or_else(|error| panic!("{}: {error}", self.key));
        }
        options.set(&format!("{}={value}", self.key)).unwrap_or_else(|error| panic!("{}: {error}", self.key));
        (self.observe)(&options)
    }

    fn failure(&self, base: &Options) -> Option<String> {
        let [first, second] = self.values.map(|value| self.observed(base, value));
        let holds = match self.expect {
            Rises => second > first,
            Falls => second < first,
            Changes => second != first,
        };
        let right = holds && first.is_finite() && second.is_finite();
        (!right).then(|| {
            let [a, b] = self.values;
            format!("{}: {first} with {a}, {second} with {b}, but {:?} is promised", self.key, self.expect)
        })
    }
}

/// Checks a table; all failures are reported at once.
pub fn check(base: &Options, table: &[Effect]) {
    let failures: Vec<String> = table.iter().filter_map(|effect| effect.failure(base)).collect();
    assert!(failures.is_empty(), "{} of {} options:\n{}", failures.len(), table.len(), failures.join("\n"));
}

/// Makes a table: `key, first => second, expectation, observation, [other settings];`.
macro_rules! effects {
    ($( $key:literal, $first:literal => $second:literal, $expect:ident, $observe:expr $(, [$($given:expr),* $(,)?])?; )*) => {
        vec![$(
            $crate::effect::Effect {
                key: $key,
                values: [$first, $second],
                expect: $crate::effect::$expect,
                given: &[$($($given),*)?],
                observe: $observe,
            },
        )*]
    };
}
pub(crate) use effects;
