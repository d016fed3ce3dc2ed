//! Ratio of the actual decrease of the cost to that predicted by the linear model, with or without memory.

/// Maximum number of successive steps that may raise the cost.
const MAX_CONSECUTIVE_NONMONOTONIC_STEPS: u32 = 5;

/// Ratio of actual to predicted decrease. With non-monotonic steps the decrease is also measured from a
/// reference some steps back (Conn, Gould and Toint, "Trust-region methods", 2000, algorithm 10.1.2).
pub(crate) struct StepQuality {
    max_consecutive_nonmonotonic_steps: u32,
    minimum_cost: f64,
    current_cost: f64,
    reference_cost: f64,
    candidate_cost: f64,
    reference_model_change: f64,
    candidate_model_change: f64,
    consecutive_nonmonotonic_steps: u32,
}

impl StepQuality {
    pub fn new(initial_cost: f64, nonmonotonic: bool) -> Self {
        Self {
            max_consecutive_nonmonotonic_steps: if nonmonotonic {
                MAX_CONSECUTIVE_NONMONOTONIC_STEPS
            } else {
                0
            },
            minimum_cost: initial_cost,
            current_cost: initial_cost,
            reference_cost: initial_cost,
            candidate_cost: initial_cost,
            reference_model_change: 0.0,
            candidate_model_change: 0.0,
            consecutive_nonmonotonic_steps: 0,
        }
    }

    /// The quality of a step to `cost` for which the model predicted `model_cost_change`.
    pub fn of(&self, cost: f64, model_cost_change: f64) -> f64 {
        let recent = (self.current_cost - cost) / model_cost_change;
        let historical = (self.reference_cost - cost) / (self.reference_model_change + model_cost_change);
        recent.max(historical)
    }

    /// Records an accepted step.
    pub fn accept(&mut self, cost: f64, model_cost_change: f64) {
        self.current_cost = cost;
        self.reference_model_change += model_cost_change;
        self.candidate_model_change += model_cost_change;
        if cost < self.minimum_cost {
            self.minimum_cost = cost;
            self.consecutive_nonmonotonic_steps = 0;
            self.candidate_cost = cost;
            self.candidate_model_change = 0.0;
        } else {
            self.consecutive_nonmonotonic_steps += 1;
            if cost > self.candidate_cost {
                self.candidate_cost = cost;
                self.candidate_model_change = 0.0;
            }
        }
        if self.consecutive_nonmonotonic_steps == self.max_consecutive_nonmonotonic_steps {
            self.reference_cost = self.candidate_cost;
            self.reference_model_change = self.candidate_model_change;
        }
    }
}
